"""Makes the small picture pair of this folder, its calibration, its product and a cell around it.

Run ``python -m tests.data.make`` from the repository; what it writes is committed. Five sticks of 80 mm lie
on a table 300 mm under two cameras, two of them crossed; drawn with the pinhole formula alone, because what
checks the detector must not share its code.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

Floats: TypeAlias = npt.NDArray[np.float64]
HERE: Final = Path(__file__).parent

WIDTH, HEIGHT = 480, 360
FOCAL_PX = 430.0
CENTRE_PX = (239.5, 179.5)
BASELINE_M = 0.060
CAMERA_BASE_M = (-0.03, -0.45, 0.32)
FLOOR_Z_M = 0.02
LENGTH_M, DIAMETER_M = 0.080, 0.004

# centre x, centre y, heading, rise of the end over the start; base frame, m and rad
STICKS: Final = (
    (-0.090, -0.480, 0.30, 0.0),
    (-0.080, -0.410, -0.20, 0.0),
    (0.020, -0.450, 1.20, 0.0),
    (0.012, -0.447, 2.60, 0.006),
    (0.075, -0.410, 1.75, 0.0),
)


def ends_base_m() -> Floats:
    """(5, 2, 3) m: start and end of every axis, robot base frame; the crossing stick lies on the other."""
    ends = []
    for x, y, heading, rise in STICKS:
        half = LENGTH_M / 2 * np.array([np.cos(heading), np.sin(heading)])
        low = FLOOR_Z_M + DIAMETER_M / 2
        z = (low, low) if rise == 0.0 else (low + 0.001, low + 0.001 + rise)
        centre = np.array([x, y])
        ends.append([[*(centre - half), z[0]], [*(centre + half), z[1]]])
    return np.array(ends)


def picture(shift_m: float, seed: int) -> npt.NDArray[np.uint8]:
    """What a camera ``shift_m`` to the right of the left one sees; straight down, x along the base's."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float64)
    grain = cv2.GaussianBlur(rng.normal(0.0, 6.0, (HEIGHT, WIDTH)), (0, 0), 1.2)
    grey = 55.0 + 8.0 * (u / WIDTH) + grain
    camera = np.array(CAMERA_BASE_M) + np.array([shift_m, 0.0, 0.0])
    for start, end in ends_base_m():
        p, q = (_pixel(point, camera) for point in (start, end))
        depth = camera[2] - (start[2] + end[2]) / 2
        radius = FOCAL_PX * DIAMETER_M / 2 / depth
        along = q - p
        length = float(np.hypot(*along))
        unit = along / length
        t = (u - p[0]) * unit[0] + (v - p[1]) * unit[1]
        side = (v - p[1]) * unit[0] - (u - p[0]) * unit[1]
        beyond = np.maximum(np.maximum(-t, t - length), 0.0)
        outside = np.maximum(np.abs(side) - radius, beyond)
        cover = np.clip(0.5 - outside, 0.0, 1.0)
        shade = 150.0 + 70.0 * np.sqrt(np.clip(1.0 - (side / radius) ** 2, 0.0, 1.0))
        grey = grey * (1.0 - cover) + shade * cover
    grey = cv2.GaussianBlur(grey, (0, 0), 0.6) + rng.normal(0.0, 1.2, (HEIGHT, WIDTH))
    return np.asarray(np.clip(np.round(grey), 0, 255), dtype=np.uint8)


def _pixel(point_base_m: Floats, camera_base_m: Floats) -> Floats:
    # camera frame: x as the base's, y against it, z down
    x, y, z = (point_base_m - camera_base_m) * [1.0, -1.0, -1.0]
    return np.array([FOCAL_PX * x / z + CENTRE_PX[0], FOCAL_PX * y / z + CENTRE_PX[1]])


def main() -> None:
    """Write everything beside this file."""
    for name, shift, seed in (("left", 0.0, 1), ("right", BASELINE_M, 2)):
        done, encoded = cv2.imencode(".png", picture(shift, seed), [cv2.IMWRITE_PNG_COMPRESSION, 9])
        if not done:
            raise RuntimeError(f"{name}.png was not encoded")
        (HERE / f"{name}.png").write_bytes(encoded.tobytes())
    matrix = [[FOCAL_PX, 0.0, CENTRE_PX[0]], [0.0, FOCAL_PX, CENTRE_PX[1]], [0.0, 0.0, 1.0]]
    x, y, z = CAMERA_BASE_M
    calibration = {
        "version": 1,
        "units": "m",
        "image_width": WIDTH,
        "image_height": HEIGHT,
        "K1": matrix,
        "D1": [0.0] * 5,
        "K2": matrix,
        "D2": [0.0] * 5,
        "R": np.eye(3).tolist(),
        "T": [-BASELINE_M, 0.0, 0.0],
        "base_from_camera": [
            [1.0, 0.0, 0.0, x],
            [0.0, -1.0, 0.0, y],
            [0.0, 0.0, -1.0, z],
            [0.0, 0.0, 0.0, 1.0],
        ],
        "table_normal": [0.0, 0.0, -1.0],
        "table_offset": z - FLOOR_Z_M,
        "rms_px": 0.0,
        "cameras": {"left": "drawn-left", "right": "drawn-right"},
    }
    (HERE / "calibration.json").write_text(json.dumps(calibration, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
