"""The calibration board as seen by an eye: a flat printed plate, sixteen rays per pixel."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from drivers.sim.board import Pattern
from drivers.sim.geometry import Floats
from drivers.sim.layout import WorldLayout
from drivers.sim.optics import Eye
from drivers.sim.surfaces import Picture

RAYS: Final = 16
"""Per pixel, on a lattice with as many different rows and columns: a square grid of them would move every
edge that runs along the picture by up to an eighth of a pixel."""
WHITE, BLACK = 0.62, 0.03
"""Shares of light that paper and toner give back."""
NEAR_M: Final = 0.02


class BoardLook:
    """Paints the board into the linear picture of one eye."""

    def __init__(self, world: WorldLayout, slopes: Floats, per_u: Floats, per_v: Floats) -> None:
        self._world = world
        self._pattern: Pattern | None = None
        self._slopes, self._per_u, self._per_v = slopes, per_u, per_v
        spread = (np.arange(RAYS) - 0.5 * (RAYS - 1)) / RAYS
        self._offsets = [(spread[k], spread[7 * k % RAYS]) for k in range(RAYS)]

    def paint(
        self, linear: Picture, nearest: npt.NDArray[np.float32], camera_from_board: Floats, eye: Eye
    ) -> None:
        """Write the board into ``linear`` (H, W, 3) and ``nearest`` (H, W) m where nothing is before it."""
        if self._pattern is None:
            self._pattern = Pattern(self._world.board)
        layout = self._world.board
        low = -layout.margin_m
        right = layout.squares[0] * layout.square_m + layout.margin_m
        bottom = layout.squares[1] * layout.square_m + layout.margin_m
        corners = np.array([[x, y, 0.0] for x in (low, right) for y in (low, bottom)])
        seen = corners @ camera_from_board[:3, :3].T + camera_from_board[:3, 3]
        if seen[:, 2].min() < NEAR_M:
            return
        window = self._window(seen[:, :2] / seen[:, 2:])
        if window is None:
            return
        rows, columns = window
        normal, origin = camera_from_board[:3, 2], camera_from_board[:3, 3]
        front = float(normal @ origin) > 0  # the board's z axis points into it, away from who looks at it
        shine = self._shine(camera_from_board, eye, front=front)
        shape = (rows.stop - rows.start, columns.stop - columns.start)
        share, tone = np.zeros(shape), np.zeros(shape)
        depth = np.full(shape, np.inf)
        slopes, per_u, per_v = (a[rows, columns] for a in (self._slopes, self._per_u, self._per_v))
        x_axis, y_axis = camera_from_board[:3, 0], camera_from_board[:3, 1]
        away = float(normal @ origin)
        for du, dv in self._offsets:
            ray = slopes + du * per_u + dv * per_v
            with np.errstate(divide="ignore", invalid="ignore"):
                far = away / (ray[..., 0] * normal[0] + ray[..., 1] * normal[1] + normal[2])
            point = far[..., None] * ray
            x = point[..., 0] * x_axis[0] + point[..., 1] * x_axis[1] + far * x_axis[2] - origin @ x_axis
            y = point[..., 0] * y_axis[0] + point[..., 1] * y_axis[1] + far * y_axis[2] - origin @ y_axis
            on = (far > NEAR_M) & (x >= low) & (x <= right) & (y >= low) & (y <= bottom)
            black = self._pattern.black(x, y) if front else np.zeros(shape, dtype=np.bool_)
            share += on
            tone += np.where(on, np.where(black, BLACK, WHITE), 0.0)
            depth = np.where(on, np.minimum(depth, far), depth)
        before = depth < nearest[rows, columns]
        share = np.where(before, share, 0.0) / len(self._offsets)
        tone = np.where(before, tone, 0.0) / len(self._offsets)
        patch = linear[rows, columns]
        linear[rows, columns] = patch * (1.0 - share[..., None]) + (tone * shine)[..., None]
        nearest[rows, columns] = np.where(before & (share > 0.5), depth, nearest[rows, columns])

    def _window(self, seen: Floats) -> tuple[slice, slice] | None:
        """Rows and columns of the picture that may show the board, from the slopes of its corners."""
        inside = np.all(
            (self._slopes >= seen.min(axis=0) - 0.01) & (self._slopes <= seen.max(axis=0) + 0.01), axis=-1
        )
        rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
        if not len(rows):
            return None
        return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)

    def _shine(self, camera_from_board: Floats, eye: Eye, *, front: bool) -> float:
        """Light on the board's middle: room, and the lamp as far as it faces it."""
        light, layout = self._world.light, self._world.board
        middle = 0.5 * layout.square_m * np.array([layout.squares[0], layout.squares[1], 0.0])
        base = eye.base_from_camera @ camera_from_board
        place = base[:3, :3] @ middle + base[:3, 3]
        face = -base[:3, 2] if front else base[:3, 2]
        to_lamp = np.array(light.position_m) - place
        cosine = float(face @ to_lamp / np.linalg.norm(to_lamp))
        return light.ambient + light.strength * max(cosine, 0.0)
