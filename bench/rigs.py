"""The bench's two stereo rigs over a table: poses, lenses, calibration; and the rays of their pictures."""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from bench.meet import FINE, Small
from cell import calibration
from cell.calibration import Calibration
from drivers.sim.layout import CameraLayout, CamerasLayout
from drivers.sim.optics import Eye, eyes
from vision.types import Floats

TABLE_Z_M = 0.02
"""Height of the table's upper face in the robot's base frame."""
MIDDLE_M = (0.0, -0.45)
"""Where on the table both cameras look."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """Two cameras that look down on the table. ``mono``: the files are grey."""

    name: str
    cameras: CamerasLayout
    mono: bool
    stick_length_m: float


WEBCAM = Rig(
    name="own-webcam",
    mono=False,
    stick_length_m=0.1,
    cameras=CamerasLayout(
        width_px=640,
        height_px=480,
        blur_px=0.7,
        noise=2.0,
        left=CameraLayout(
            position_m=(-0.041, -0.447, 0.419),
            look_at_m=(-0.008, -0.451, TABLE_Z_M),
            roll_rad=0.011,
            focal_px=(597.4, 598.6),
            centre_px=(323.7, 236.2),
            distortion=(-0.088, 0.043, 0.0008, -0.0007, -0.004),
        ),
        right=CameraLayout(
            position_m=(0.039, -0.449, 0.421),
            look_at_m=(0.010, -0.447, TABLE_Z_M),
            roll_rad=-0.009,
            focal_px=(601.2, 601.9),
            centre_px=(315.8, 243.9),
            distortion=(-0.102, 0.058, -0.0006, 0.0009, -0.009),
        ),
    ),
)
INDUSTRIAL = Rig(
    name="own-industrial",
    mono=True,
    stick_length_m=0.08,
    cameras=CamerasLayout(
        width_px=800,
        height_px=600,
        blur_px=0.65,
        noise=2.2,
        left=CameraLayout(
            position_m=(-0.060, -0.452, 0.718),
            look_at_m=(-0.004, -0.449, TABLE_Z_M),
            roll_rad=-0.008,
            focal_px=(1762.5, 1763.4),
            centre_px=(404.6, 296.3),
            distortion=(-0.171, 0.116, 0.0003, -0.0004, 0.0),
        ),
        right=CameraLayout(
            position_m=(0.063, -0.449, 0.722),
            look_at_m=(0.003, -0.451, TABLE_Z_M),
            roll_rad=0.006,
            focal_px=(1770.8, 1771.2),
            centre_px=(394.1, 304.7),
            distortion=(-0.186, 0.138, -0.0002, 0.0003, 0.0),
        ),
    ),
)
RIGS = {"webcam": WEBCAM, "industrial": INDUSTRIAL}
"""By the word a command takes."""


@cache
def rays(rig: Rig) -> tuple[tuple[Eye, Small], tuple[Eye, Small]]:
    """Both eyes of a rig, each with the slopes (FH, FW, 2) of all rays of its pictures."""
    found = []
    for eye in eyes(rig.cameras):
        u, v = np.meshgrid(
            np.arange(eye.width_px, dtype=np.float64), np.arange(eye.height_px, dtype=np.float64)
        )
        slopes = eye.slopes(np.stack([u, v], axis=-1))
        per_u, per_v = np.gradient(slopes, axis=1), np.gradient(slopes, axis=0)
        fine = np.empty((FINE * eye.height_px, FINE * eye.width_px, 2), np.float32)
        for i in range(FINE):
            for j in range(FINE):
                du, dv = (j - 0.5 * (FINE - 1)) / FINE, (i - 0.5 * (FINE - 1)) / FINE
                fine[i::FINE, j::FINE] = slopes + du * per_u + dv * per_v
        fine.setflags(write=False)
        found.append((eye, fine))
    return found[0], found[1]


def rig_text(rig: Rig) -> str:
    """The rig's true calibration as a scene set's JSON: millimetres, pixels."""
    left, right = eyes(rig.cameras)
    right_from_left = right.camera_from_base @ left.base_from_camera

    def told(numbers: Floats) -> list[float]:
        rounded: list[float] = (np.round(numbers, 12) + 0.0).tolist()
        return rounded

    def in_mm(pose: Floats) -> Floats:
        scaled = pose.copy()
        scaled[:3, 3] *= 1000.0
        return scaled

    def camera(eye: Eye, layout: CameraLayout) -> dict[str, list[float]]:
        return {"K": told(eye.matrix()), "dist": list(layout.distortion)}

    content = {
        "name": rig.name,
        "units": "mm",
        "image_size": [rig.cameras.width_px, rig.cameras.height_px],
        "mono": rig.mono,
        "left": camera(left, rig.cameras.left),
        "right": camera(right, rig.cameras.right),
        "R": told(right_from_left[:3, :3]),
        "T": told(1000.0 * right_from_left[:3, 3]),
        "baseline_mm": float(1000.0 * np.linalg.norm(right_from_left[:3, 3])),
        "T_base_cam": told(in_mm(left.base_from_camera)),
        "table_plane_leftcam": {
            "normal": told(left.base_from_camera[2, :3]),
            "d": float(1000.0 * (left.base_from_camera[2, 3] - TABLE_Z_M)),
        },
    }
    return json.dumps(content, indent=1) + "\n"


def known(rig: Rig) -> Calibration:
    """The rig's calibration, read back the way the cell reads it."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{rig.name}.json"
        file.write_text(rig_text(rig), encoding="utf-8")
        return calibration.load(file)
