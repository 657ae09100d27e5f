"""Calibration files as Mikado writes them: JSON with a checksum; and OpenCV's YAML, out and in.

The checksum is there because a calibration is data nobody should touch by hand: one wrong digit moves every
pick, and nothing else would show it.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Final, TypeAlias

import cv2
import numpy as np

from cell.errors import CalibrationError, UsageError

Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | bool | None"

CHECKSUM: Final = "checksum"


def checksum_of(fields: dict[str, Json]) -> str:
    """SHA-256 of everything but the checksum itself, independent of order and of spaces."""
    rest = {key: value for key, value in fields.items() if key != CHECKSUM}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def refuse_changed(path: Path, fields: dict[str, Json]) -> None:
    """Raise `CalibrationError` for a file with a checksum that is not that of its content."""
    stated = fields.get(CHECKSUM)
    if stated is not None and stated != checksum_of(fields):
        raise CalibrationError(
            f"{path}: the content does not fit its checksum: it was changed or damaged since it was made; "
            "calibrate again, or take a copy that was kept"
        )


def write(path: Path, fields: dict[str, Json]) -> None:
    """Write a calibration with its checksum, whole or not at all.

    Raises
    ------
    UsageError
        The file cannot be written.
    """
    document = {key: value for key, value in fields.items() if key != CHECKSUM}
    document[CHECKSUM] = checksum_of(document)
    text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
    beside = path.with_name(path.name + ".new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with beside.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error


def read(path: Path) -> dict[str, Json]:
    """The content of a calibration file written by `write`.

    Raises
    ------
    CalibrationError
        Missing, no JSON object, or changed since it was written.
    """
    try:
        data: Json = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CalibrationError(f"{path}: not readable as JSON: {error}") from error
    if not isinstance(data, dict):
        raise CalibrationError(f"{path}: a JSON object is expected")
    refuse_changed(path, data)
    return data


def export_opencv(path: Path, fields: dict[str, Json]) -> None:
    """Write the geometry as OpenCV's YAML: K1 D1 K2 D2 R T in the units of the file, image size, T_base_cam.

    Raises
    ------
    UsageError
        The file cannot be written, or its name ends in none of OpenCV's.
    """
    if path.suffix.lower() not in (".yaml", ".yml", ".xml", ".json"):
        raise UsageError(f"{path}: OpenCV tells the format by the name; use .yaml, .yml, .xml or .json")
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    except (cv2.error, SystemError) as error:
        raise UsageError(f"{path}: cannot be written") from error
    if not storage.isOpened():
        raise UsageError(f"{path}: cannot be written")
    try:
        for key in ("image_width", "image_height"):
            storage.write(key, int(np.asarray(fields[key]).item()))
        storage.write("units", str(fields.get("units", "m")))
        for key in ("K1", "D1", "K2", "D2", "R", "T", "T_base_cam"):
            if fields.get(key) is not None:
                values = np.asarray(fields[key], dtype=np.float64)
                storage.write(key, values.reshape(-1, 1) if key == "T" else np.atleast_2d(values))
    finally:
        storage.release()
