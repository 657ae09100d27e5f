"""The simulated eyes: pinholes with radial and tangential distortion, and their calibration.

Written apart from the detector's projection on purpose. The formula is the five-coefficient model of Brown
(1966) as OpenCV documents it: k1, k2, p1, p2, k3. Pixels (u, v), centres at whole coordinates.
"""

from __future__ import annotations

import json

import numpy as np

from drivers.sim.geometry import Floats, apply, inverse, looking_at, pose_matrix
from drivers.sim.layout import ArmLayout, CameraLayout, CamerasLayout


class Eye:
    """One camera: its pose, and both directions of its projection.

    ``base_from_carrier`` (4, 4) is where the flange is, of an eye on the arm; the base itself otherwise.
    """

    def __init__(
        self, layout: CameraLayout, width_px: int, height_px: int, base_from_carrier: Floats | None = None
    ) -> None:
        self._layout = layout
        self.width_px = width_px
        self.height_px = height_px
        self.carrier_from_camera = looking_at(
            np.array(layout.position_m), np.array(layout.look_at_m), layout.roll_rad
        )
        self.base_from_camera = self.carrier_from_camera
        if base_from_carrier is not None:
            self.base_from_camera = base_from_carrier @ self.carrier_from_camera
        self.camera_from_base = inverse(self.base_from_camera)

    def carried(self, base_from_carrier: Floats) -> Eye:
        """The same eye where its carrier is there."""
        return Eye(self._layout, self.width_px, self.height_px, base_from_carrier)

    @property
    def focal_px(self) -> float:
        """Mean focal length, px."""
        return 0.5 * (self._layout.focal_px[0] + self._layout.focal_px[1])

    def matrix(self) -> Floats:
        """(3, 3) camera matrix, px."""
        (fx, fy), (cx, cy) = self._layout.focal_px, self._layout.centre_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def project(self, points_m: Floats) -> Floats:
        """(N, 3) m in the base frame to (N, 2) px in the raw picture; points in front of the eye only."""
        seen = apply(self.camera_from_base, points_m)
        bent = self._bend(seen[:, :2] / seen[:, 2:3])
        return np.asarray(bent * np.array(self._layout.focal_px) + np.array(self._layout.centre_px))

    def _bend(self, straight: Floats) -> Floats:
        """Ideal image coordinates (..., 2), unit focal length, to distorted ones."""
        k1, k2, p1, p2, k3 = self._layout.distortion
        x, y = straight[..., 0], straight[..., 1]
        rr = x * x + y * y
        radial = 1.0 + rr * (k1 + rr * (k2 + rr * k3))
        return np.stack(
            [
                x * radial + 2.0 * p1 * x * y + p2 * (rr + 2.0 * x * x),
                y * radial + p1 * (rr + 2.0 * y * y) + 2.0 * p2 * x * y,
            ],
            axis=-1,
        )

    def slopes(self, pixels: Floats) -> Floats:
        """(..., 2) px of the raw picture to the slopes (x / z, y / z) of their rays, camera frame."""
        bent = (pixels - np.array(self._layout.centre_px)) / np.array(self._layout.focal_px)
        straight = bent.copy()
        for _ in range(12):  # a contraction for any lens one would buy; 1e-9 after a few turns
            straight += bent - self._bend(straight)
        return np.asarray(straight)


def eyes(layout: CamerasLayout) -> tuple[Eye, Eye]:
    """Left and right eye; those on the arm as if the flange were the base."""
    left, right = (Eye(side, layout.width_px, layout.height_px) for side in (layout.left, layout.right))
    return left, right


def calibration_text(layout: CamerasLayout, arm: ArmLayout) -> str:
    """The calibration an honest commissioning would have found, as JSON text in metres and pixels.

    ``R``, ``T`` take left camera coordinates to right ones; ``base_from_camera`` (4, 4) takes coordinates of
    the raw left camera to the robot's base, ``tool_from_camera`` those of one on the arm to its tool.
    """
    left, right = eyes(layout)
    place = {"base_from_camera": left.carrier_from_camera}
    if layout.mount == "tool":
        place = {"tool_from_camera": inverse(pose_matrix(arm.tcp_m_rad)) @ left.carrier_from_camera}
    right_from_left = right.camera_from_base @ left.base_from_camera
    content = {
        "version": 1,
        "units": "m",
        "image_width": layout.width_px,
        "image_height": layout.height_px,
        "K1": left.matrix().tolist(),
        "D1": list(layout.left.distortion),
        "K2": right.matrix().tolist(),
        "D2": list(layout.right.distortion),
        "R": _told(right_from_left[:3, :3]),
        "T": _told(right_from_left[:3, 3]),
        **{name: _told(pose) for name, pose in place.items()},
        "rms_px": 0.0,
        "cameras": {"left": "sim-left", "right": "sim-right"},
    }
    return json.dumps(content, indent=1) + "\n"


def _told(numbers: Floats) -> list[float] | list[list[float]]:
    """Twelve decimals: the last bits differ from one maker's processor to the next."""
    told: list[float] | list[list[float]] = (np.round(numbers, 12) + 0.0).tolist()
    return told
