"""Pictures of straight sticks on a table, drawn with projection code of their own.

A stick is a bright band between the two silhouette lines of its cylinder, darker towards its flanks, or lit
by Lambert's law from one side. A pixel's share of it follows from its distances to the four sides of the
band, so edges lie where they should to hundredths of a pixel. Sticks are painted from the lowest to the
highest.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from vision.types import CameraModel, Plane, StereoModel, Transform

Floats = npt.NDArray[np.float64]
Grey = npt.NDArray[np.uint8]

DEPTH_M = 0.4
AMBIENT = 0.25
TABLE = Plane(normal=np.array([0.0, 0.0, -1.0]), offset_m=DEPTH_M)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stick:
    """``start``, ``end`` (3,) m, left camera frame."""

    start: Floats
    end: Floats
    radius_m: float = 0.002


def lying(
    x_m: float,
    y_m: float,
    angle_deg: float,
    *,
    length_m: float = 0.1,
    height_m: float = 0.002,
    tilt_deg: float = 0.0,
) -> Stick:
    """A stick by its centre on the table, its direction in the picture and the height of its axis."""
    along = np.array(
        [
            np.cos(np.radians(angle_deg)) * np.cos(np.radians(tilt_deg)),
            np.sin(np.radians(angle_deg)) * np.cos(np.radians(tilt_deg)),
            -np.sin(np.radians(tilt_deg)),
        ]
    )
    centre = np.array([x_m, y_m, DEPTH_M - height_m])
    return Stick(start=centre - 0.5 * length_m * along, end=centre + 0.5 * length_m * along)


def rig() -> StereoModel:
    """Two cameras 70 mm apart that turn towards each other, without distortion."""
    camera = CameraModel(
        matrix=np.array([[570.0, 0.0, 319.5], [0.0, 570.0, 239.5], [0.0, 0.0, 1.0]]),
        distortion=np.zeros(5),
        width_px=640,
        height_px=480,
    )
    turn = 0.1
    rotation = np.array(
        [[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]]
    )
    centre = np.array([0.07, 0.0, 0.0])
    return StereoModel(
        left=camera,
        right=camera,
        right_from_left=Transform(rotation=rotation, translation=-rotation @ centre),
    )


def pair(
    sticks: list[Stick],
    *,
    seed: int = 0,
    table_grey: float = 40.0,
    light: float = 160.0,
    light_from: Floats | None = None,
    gamma: float = 1.0,
    noise_grey: float = 2.0,
    row_offset_px: float = 0.0,
) -> tuple[Grey, Grey]:
    """Both pictures (480, 640) with blur and noise.

    Parameters
    ----------
    light_from : (3,)
        Direction to a distant light, left camera frame: sticks are Lambert's cylinders with a little light
        from everywhere. None: the same from both sides.
    gamma
        Grey values are light to the power of one over it; ``table_grey`` and ``light`` stay light.
    row_offset_px
        Added to the rows of the right picture, as by a camera that has been knocked.
    """
    model = rig()
    still = Transform(rotation=np.eye(3), translation=np.zeros(3))
    random = np.random.default_rng(seed)
    views = []
    for camera, motion, offset in (
        (model.left, still, 0.0),
        (model.right, model.right_from_left, row_offset_px),
    ):
        picture = np.full((camera.height_px, camera.width_px), table_grey)
        for stick in sorted(sticks, key=lambda s: -float(s.start[2] + s.end[2])):
            share, shade = _band(stick, camera, motion, light_from, offset)
            picture = (1.0 - share) * picture + share * (table_grey + light * shade)
        soft = cv2.GaussianBlur(picture, (0, 0), 0.7)
        encoded = 255.0 * np.clip(np.asarray(soft, np.float64) / 255.0, 0.0, 1.0) ** (1.0 / gamma)
        noisy = encoded + random.normal(0.0, noise_grey, soft.shape)
        views.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    return views[0], views[1]


def _band(
    stick: Stick, camera: CameraModel, motion: Transform, light_from: Floats | None, row_offset_px: float
) -> tuple[Floats, Floats]:
    """(H, W) how much of each pixel the stick covers, and how bright it is there, 0..1."""
    start = motion.rotation @ stick.start + motion.translation
    end = motion.rotation @ stick.end + motion.translation
    axis = (end - start) / np.linalg.norm(end - start)
    sides, caps_px = [], []
    for point in (start, end):
        # the end face is a disc: seen at an angle it reaches beyond the axis' end, most in its middle
        cosine = abs(float(axis @ point)) / float(np.linalg.norm(point))
        caps_px.append(stick.radius_m * cosine * camera.matrix[0, 0] / point[2])
        aside = np.cross(axis, point)
        aside *= stick.radius_m / np.linalg.norm(aside)
        sides.append((_pixel(point - aside, camera), _pixel(point + aside, camera)))
    (a, b), (d, c) = sides
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(np.float64)
    v -= row_offset_px
    inside = []
    middle = 0.25 * (a + b + c + d)
    for first, second in ((a, d), (b, c), (a, b), (d, c)):
        way = (second - first) / np.linalg.norm(second - first)
        sign = np.sign(way[0] * (middle[1] - first[1]) - way[1] * (middle[0] - first[0]))
        inside.append(sign * (way[0] * (v - first[1]) - way[1] * (u - first[0])))
    across = np.abs(inside[0] - inside[1]) / np.maximum(np.abs(inside[0] + inside[1]), 1e-9)
    bulge = np.sqrt(1.0 - np.minimum(across, 1.0) ** 2)
    inside[2] += caps_px[0] * bulge
    inside[3] += caps_px[1] * bulge
    share = np.prod([np.clip(0.5 + distance, 0.0, 1.0) for distance in inside], axis=0)
    if light_from is None:
        return share, 1.0 - 0.5 * np.minimum(across, 1.0) ** 2
    # from the side of a to the side of b the normal turns from one outline over the camera to the other
    signed = np.clip((inside[0] - inside[1]) / np.maximum(np.abs(inside[0] + inside[1]), 1e-9), -1.0, 1.0)
    ray = 0.5 * (start + end)
    sideways = np.cross(axis, ray)
    sideways /= np.linalg.norm(sideways)
    facing = np.cross(axis, sideways)
    facing *= -np.sign(facing @ ray)
    sun = motion.rotation @ light_from
    lit = signed * float(sideways @ sun) + np.sqrt(1.0 - signed**2) * float(facing @ sun)
    return share, AMBIENT + (1.0 - AMBIENT) * np.maximum(lit, 0.0)


def _pixel(point: Floats, camera: CameraModel) -> Floats:
    ray = camera.matrix @ (point / point[2])
    return np.asarray(ray[:2], np.float64)
