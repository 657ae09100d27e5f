"""Which webcams are there, by the names that stay, and what each offers."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from drivers.camera.v4l2_device import VideoDevice
from drivers.camera.v4l2_errors import explained
from drivers.types import FoundCamera

_BY_PATH: Final = "by-path"
_BY_ID: Final = "by-id"


def found(links: Path = Path("/dev/v4l")) -> tuple[FoundCamera, ...]:
    """Every capture device with a stable name, by socket (by-path) where it has such a name.

    Nodes for metadata are left out. A device that cannot be asked is listed with the reason.
    """
    names: dict[Path, list[Path]] = {}
    for kind in (_BY_PATH, _BY_ID):
        folder = links / kind
        if not folder.is_dir():
            continue
        for link in sorted(folder.iterdir()):
            # index 1 and up of a webcam are its metadata; newer kernels have a second name with usbv2
            if link.name.endswith("-video-index0"):
                names.setdefault(link.resolve(), []).append(link)
    cameras = (_camera(links_of) for _, links_of in sorted(names.items()))
    return tuple(camera for camera in cameras if camera is not None)


def _camera(names: list[Path]) -> FoundCamera | None:
    first, *others = names
    also = tuple(str(other) for other in others)
    try:
        device = VideoDevice(first)
    except OSError as error:
        problem = explained(str(first), first, "open", error).detail
        return FoundCamera(driver="v4l2", device=str(first), also=also, problem=problem)
    try:
        identity = device.identity()
        if not identity.captures:
            return None
        return FoundCamera(
            driver="v4l2",
            device=str(first),
            also=also,
            model=f"{identity.model} ({identity.driver}, {identity.bus})",
            formats=tuple(offer.text() for offer in device.offered()),
            controls=tuple(
                f"{control.label}: {control.minimum} to {control.maximum}, steps of {control.step}, usually "
                f"{control.default}{' (automatic has it)' if control.inactive else ''}"
                for control in device.controls()
            ),
        )
    except OSError as error:
        problem = explained(str(first), first, "ask", error).detail
        return FoundCamera(driver="v4l2", device=str(first), also=also, problem=problem)
    finally:
        device.close()
