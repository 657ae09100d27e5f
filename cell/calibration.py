"""Calibration files: read, check, and hand out as the detector's `StereoModel`.

Three forms are read. OpenCV's YAML or JSON (``cv2.FileStorage``: K1 D1 K2 D2 R T, optionally
``T_base_cam``), the JSON of rendered rigs (``left``/``right`` with ``K`` and ``dist``), and Mikado's
own JSON, which adds units, camera names and date. Everything leaves in metres.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from cell.calibration_file import Json, refuse_changed
from cell.errors import CalibrationError
from vision.stereo import depth_range, rectification
from vision.transforms import nearest_rotation
from vision.types import CameraModel, Floats, Plane, StereoModel, Transform, read_only

# A rig of two cameras over a table has a baseline between 10 mm and 2 m. The two ranges do not
# overlap in number, so a file without units still says which it means.
_METRES: Final = (0.010, 2.0)
_MILLIMETRES: Final = (10.0, 2000.0)
_ROUNDED: Final = 5e-4
"""How far a rotation or unit vector may be off: files written with four digits are good."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """What commissioning found. ``base_from_camera``: raw left camera to robot base, None if unknown;
    ``tool_from_camera``: to the tool's frame, of cameras on the arm.

    ``table`` in the left camera frame, None if the file has none. ``units`` says what the file used
    and how that was known.
    """

    path: Path
    stereo: StereoModel
    base_from_camera: Transform | None
    table: Plane | None
    units: str
    cameras: tuple[str, str] | None
    tool_from_camera: Transform | None = None


def load(path: Path) -> Calibration:
    """Read a calibration file.

    Raises
    ------
    CalibrationError
        Missing, unreadable, a matrix missing or of a wrong shape, a rotation that is none.
    """
    if not path.is_file():
        raise CalibrationError(f"{path}: calibration file not found; calibrate the cameras first")
    fields = _json(path) if path.suffix.lower() == ".json" else _opencv(path)
    return _calibration(path, _flattened(fields))


def fit(calibration: Calibration, width_px: int, height_px: int, what: str) -> None:
    """Raise `CalibrationError` when pictures of this size do not belong to the calibration."""
    for eye, camera in (("left", calibration.stereo.left), ("right", calibration.stereo.right)):
        if (camera.width_px, camera.height_px) != (width_px, height_px):
            raise CalibrationError(
                f"{calibration.path}: made for {eye} pictures of {camera.width_px}x{camera.height_px} px, "
                f"but {what} are {width_px}x{height_px}; use the calibration of these cameras"
            )


def belong(calibration: Calibration, cameras: tuple[str, str] | None, what: str) -> None:
    """Raise `CalibrationError` when a calibration was made with other cameras, if both are known."""
    made_with = calibration.cameras
    if made_with is None or cameras is None or made_with == cameras:
        return
    if made_with == cameras[::-1]:
        raise CalibrationError(
            f"{calibration.path}: left and right are swapped: it was made with {made_with[0]} on the left "
            f"and {made_with[1]} on the right, {what} has them the other way round"
        )
    raise CalibrationError(
        f"{calibration.path}: made with {made_with[0]} and {made_with[1]}, but {what} has {cameras[0]} and "
        f"{cameras[1]}; calibrate these cameras"
    )


def table_of(calibration: Calibration, floor_z_m: float) -> Plane:
    """The table of a cell in the left camera frame: the plane z = floor of the robot base.

    Raises `CalibrationError` when the calibration does not know where the robot is.
    """
    base = calibration.base_from_camera
    if base is None:
        raise CalibrationError(
            f"{calibration.path}: base_from_camera is missing; do the hand-eye calibration"
        )
    return floor_plane(base, floor_z_m)


def floor_plane(base_from_camera: Transform, floor_z_m: float) -> Plane:
    """The plane z = floor of the robot base in the frame of a left camera."""
    # height above the floor of a camera point p: (R p + t)_z - floor
    normal = np.array(base_from_camera.rotation[2], dtype=np.float64)
    return Plane(normal=read_only(normal), offset_m=float(base_from_camera.translation[2]) - floor_z_m)


def depth_bounds_m(
    calibration: Calibration, table: Plane, height_m: tuple[float, float]
) -> tuple[float, float]:
    """Distances from the left camera at which something within these heights above the table can be seen.

    Raises `CalibrationError` when the camera does not look down on the table.
    """
    try:
        return depth_range(calibration.stereo, table, height_m)
    except ValueError as error:
        raise CalibrationError(f"{calibration.path}: camera and table do not fit: {error}") from error


# ------------------------------------------------------------------------------ reading


def _opencv(path: Path) -> dict[str, Json]:
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    except (cv2.error, SystemError) as error:
        raise CalibrationError(f"{path}: not readable as an OpenCV calibration file") from error
    if not storage.isOpened():
        raise CalibrationError(f"{path}: not readable as an OpenCV calibration file")
    fields: dict[str, Json] = {}
    try:
        root = storage.root()
        for key in root.keys():  # noqa: SIM118 - a FileNode, not a dict
            node = root.getNode(key)
            fields[key] = _plain(path, key, node)
    finally:
        storage.release()
    return fields


def _plain(path: Path, key: str, node: cv2.FileNode) -> Json:
    """A node of OpenCV's storage as plain data; a matrix as its rows."""
    if node.isMap():
        names = list(node.keys())
        if not {"rows", "cols", "data"} <= set(names):
            return {name: _plain(path, f"{key}.{name}", node.getNode(name)) for name in names}
        try:
            matrix: Json = node.mat().tolist()
        except (cv2.error, SystemError) as error:
            raise CalibrationError(f"{path}: {key} is not a matrix of numbers") from error
        return matrix
    if node.isSeq():
        return [_plain(path, f"{key}[{i}]", node.at(i)) for i in range(node.size())]
    if node.isString():
        return node.string()
    return node.real() if node.isInt() or node.isReal() else None


def _json(path: Path) -> dict[str, Json]:
    try:
        data: Json = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CalibrationError(f"{path}: not readable as JSON: {error}") from error
    if not isinstance(data, dict):
        raise CalibrationError(f"{path}: a JSON object is expected")
    if "opencv_storage" in data or any(isinstance(v, dict) and "type_id" in v for v in data.values()):
        return _opencv(path)
    refuse_changed(path, data)
    return data


def _flattened(data: dict[str, Json]) -> dict[str, Json]:
    """The per-camera form (left: {K, dist}) with the names of the flat one."""
    fields = dict(data)
    for eye, number in (("left", "1"), ("right", "2")):
        camera = data.get(eye)
        if isinstance(camera, dict):
            fields[f"K{number}"] = camera.get("K")
            fields[f"D{number}"] = camera.get("dist")
    size = data.get("image_size")
    if isinstance(size, list) and len(size) == 2:
        fields["image_width"], fields["image_height"] = size
    plane = data.get("table_plane_leftcam")
    if isinstance(plane, dict):
        fields["table_normal"], fields["table_offset"] = plane.get("normal"), plane.get("d")
    if "base_from_camera" in data:
        fields["T_base_cam"] = data["base_from_camera"]
    if "tool_from_camera" in data:
        fields["T_tool_cam"] = data["tool_from_camera"]
    return fields


def _calibration(path: Path, fields: dict[str, Json]) -> Calibration:
    def matrix(key: str, *shape: int) -> Floats:
        value = fields.get(key)
        if value is None:
            raise CalibrationError(f"{path}: {key} is missing")
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            raise CalibrationError(f"{path}: {key} is not a matrix of numbers") from None
        if shape == (-1,):
            array = array.reshape(-1)
        elif array.size != math.prod(shape):
            raise CalibrationError(f"{path}: {key} has {array.size} numbers, expected {math.prod(shape)}")
        else:
            array = array.reshape(shape)
        if not np.isfinite(array).all():
            raise CalibrationError(f"{path}: {key} holds a number that is not finite")
        read_only(array)
        return array

    def number(key: str) -> float:
        value = fields.get(key)
        if not isinstance(value, int | float) or not math.isfinite(value):
            raise CalibrationError(f"{path}: {key} is missing or not a number")
        return float(value)

    width, height = int(number("image_width")), int(number("image_height"))
    shift = matrix("T", 3)
    units, scale = _units(path, fields.get("units"), float(np.linalg.norm(shift)))
    rotation = _rotation(path, "R", matrix("R", 3, 3))

    def pose(key: str) -> Transform | None:
        if fields.get(key) is None:
            return None
        rows = matrix(key, 4, 4)
        if not np.array_equal(rows[3], [0.0, 0.0, 0.0, 1.0]):
            raise CalibrationError(f"{path}: the last row of {key} is not 0 0 0 1; is it transposed?")
        return Transform(
            rotation=_rotation(path, key, rows[:3, :3]), translation=read_only(rows[:3, 3] * scale)
        )

    table: Plane | None = None
    if fields.get("table_normal") is not None:
        normal = matrix("table_normal", 3)
        if abs(float(np.linalg.norm(normal)) - 1.0) > _ROUNDED:
            raise CalibrationError(f"{path}: table_normal is not of length 1")
        table = Plane(normal=normal, offset_m=number("table_offset") * scale)
    names = fields.get("cameras")
    cameras = (str(names.get("left")), str(names.get("right"))) if isinstance(names, dict) else None
    rms = fields.get("rms_px")
    model = StereoModel(
        left=_camera(path, matrix("K1", 3, 3), matrix("D1", -1), width, height, "K1"),
        right=_camera(path, matrix("K2", 3, 3), matrix("D2", -1), width, height, "K2"),
        right_from_left=Transform(rotation=rotation, translation=read_only(shift * scale)),
        rms_px=float(rms) if isinstance(rms, int | float) else float("nan"),
    )
    try:
        rectification(model)
    except ValueError as error:
        raise CalibrationError(f"{path}: {error}") from error
    return Calibration(
        path=path,
        stereo=model,
        base_from_camera=pose("T_base_cam"),
        tool_from_camera=pose("T_tool_cam"),
        table=table,
        units=units,
        cameras=cameras,
    )


def _camera(path: Path, matrix: Floats, distortion: Floats, width: int, height: int, key: str) -> CameraModel:
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or matrix[2, 2] != 1:
        raise CalibrationError(f"{path}: {key} is no camera matrix (focal lengths > 0, last element 1)")
    if distortion.size not in (4, 5, 8, 12, 14):
        raise CalibrationError(
            f"{path}: {distortion.size} distortion numbers beside {key}; 4, 5, 8, 12 or 14"
        )
    if width <= 0 or height <= 0:
        raise CalibrationError(f"{path}: image size {width}x{height} is not possible")
    return CameraModel(matrix=matrix, distortion=distortion, width_px=width, height_px=height)


def _rotation(path: Path, key: str, rotation: Floats) -> Floats:
    """The rotation without the rounding of the file: the detector asks for more digits than files have."""
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if error > _ROUNDED or np.linalg.det(rotation) < 0:
        raise CalibrationError(f"{path}: the rotation in {key} is none (off by {error:.2g})")
    exact = nearest_rotation(rotation)
    read_only(exact)
    return exact


def _units(path: Path, stated: Json, baseline: float) -> tuple[str, float]:
    """How lengths in the file are meant: a text for people, and the factor to metres."""
    match stated:
        case "m":
            known, scale = "m, as stated", 1.0
        case "mm":
            known, scale = "mm, as stated", 1e-3
        case None if _METRES[0] <= baseline < _METRES[1]:
            known, scale = f"m, from a baseline of {baseline:.4g}", 1.0
        case None if _MILLIMETRES[0] <= baseline <= _MILLIMETRES[1]:
            known, scale = f"mm, from a baseline of {baseline:.4g}", 1e-3
        case None:
            raise CalibrationError(
                f"{path}: T is {baseline:.4g} long, which is no baseline of a rig in metres or millimetres; "
                "add units: m or mm"
            )
        case _:
            raise CalibrationError(f"{path}: units {stated!r}; m or mm is expected")
    low, high = _METRES
    if not low <= baseline * scale <= high:
        raise CalibrationError(
            f"{path}: baseline of {baseline * scale:.4g} m is outside {low} to {high} m; are the units right?"
        )
    return known, scale


def widest_view_m(stereo: StereoModel, depth_m: float) -> float:
    """Length in metres of the picture's diagonal at a distance, the smaller of the two cameras."""
    views = []
    for camera in (stereo.left, stereo.right):
        width = camera.width_px / camera.matrix[0, 0] * depth_m
        height = camera.height_px / camera.matrix[1, 1] * depth_m
        views.append(math.hypot(width, height))
    return min(views)
