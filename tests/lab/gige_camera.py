"""A GigE Vision camera, a process of its own: Aravis' fake camera (GVCP and GVSP on a real interface), with
pictures that are ours: those of the simulated cell, or one file. Each carries a stamp in its pixels.

    python -m tests.lab.gige_camera --address 10.77.1.2 --serial LEFT --picture left.png [--netns NAME]
    python -m tests.lab.gige_camera --address 10.77.1.2 --serial LEFT --cell 40123 --eye left [--netns NAME]

The connection to the simulated cell is made before the process enters the network namespace, and stays with
the loopback it was made on.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeAlias

import cv2
import gi
import numpy as np
import numpy.typing as npt

from drivers.camera_settings import SimCameraSettings
from drivers.sim.devices import Link, SimCamera
from drivers.timing import MonotonicClock
from tests.lab import stamp

gi.require_version("Aravis", "0.8")
from gi.repository import Aravis, GLib  # noqa: E402 - the version has to be asked for first

Picture: TypeAlias = npt.NDArray[np.uint8]
_CLONE_NEWNET: Final = 0x40000000
MONO16: Final = 0x01100007
RGB8: Final = 0x02180014
BAYERS: Final = {0x01080008: "GR", 0x01080009: "RG", 0x0108000A: "GB", 0x0108000B: "BG"}
EXPOSURE_US: Final = 5000.0
"""The exposure at which pictures come as they are."""

_library = ctypes.CDLL("libaravis-0.8.so.0")
_library.arv_buffer_get_data.restype = ctypes.c_void_p
_library.arv_buffer_get_data.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t)]
for _name in ("width", "height", "x", "y"):
    getattr(_library, f"arv_buffer_get_image_{_name}").argtypes = [ctypes.c_void_p]
_FILL = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32
)
_library.arv_fake_camera_set_fill_pattern.argtypes = [ctypes.c_void_p, _FILL, ctypes.c_void_p]


def enter(name: str) -> None:
    """Go over into a named network namespace, this thread and all it starts."""
    libc = ctypes.CDLL(None, use_errno=True)
    with Path("/var/run/netns", name).open("rb") as held:
        if libc.setns(held.fileno(), _CLONE_NEWNET) != 0:
            code = ctypes.get_errno()
            raise OSError(code, f"cannot enter the network namespace {name}: {os.strerror(code)}")


def as_sent(picture: Picture, pixel_format: int) -> Picture:
    """The bytes of (H, W, 3) BGR pixels in a pixel format, as rows."""
    if pixel_format == RGB8:
        return picture[:, :, ::-1].reshape(picture.shape[0], -1)
    pattern = BAYERS.get(pixel_format)
    if pattern is not None:
        mosaic = np.empty(picture.shape[:2], dtype=np.uint8)
        colours = {"B": 0, "G": 1, "R": 2}
        order = {"RG": "RGGB", "BG": "BGGR", "GR": "GRBG", "GB": "GBRG"}[pattern]
        for place, colour in enumerate(order):
            y, x = divmod(place, 2)
            mosaic[y::2, x::2] = picture[y::2, x::2, colours[colour]]
        return mosaic
    grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    if pixel_format == MONO16:
        return (grey.astype("<u2") << 8).view(np.uint8).reshape(grey.shape[0], -1)
    return grey


class Painter:
    """Fills the fake camera's buffers, on its thread."""

    def __init__(self, picture: Callable[[], Picture]) -> None:
        self._picture = picture
        self._number = 0
        self.callback = _FILL(self._fill)

    def _fill(self, buffer: int, _data: int, exposure_us: int, gain: int, pixel_format: int) -> None:
        try:
            self._paint(buffer, exposure_us, gain, pixel_format)
        except BaseException as error:  # noqa: BLE001 - nothing may pass into C; the process is over
            print(f"the picture failed: {error!r}", file=sys.stderr, flush=True)
            os._exit(1)

    def _paint(self, buffer: int, exposure_us: int, gain: int, pixel_format: int) -> None:
        exposed_at = time.monotonic()
        width, height, x, y = (
            getattr(_library, f"arv_buffer_get_image_{name}")(buffer)
            for name in ("width", "height", "x", "y")
        )
        whole = self._picture()
        if x + width > whole.shape[1] or y + height > whole.shape[0]:
            room = np.zeros((max(y + height, whole.shape[0]), max(x + width, whole.shape[1]), 3), np.uint8)
            room[: whole.shape[0], : whole.shape[1]] = whole
            whole = room
        part = whole[y : y + height, x : x + width]
        light = exposure_us / EXPOSURE_US * 10.0 ** (gain / 20.0)
        part = np.clip(part * light, 0.0, 255.0).astype(np.uint8)
        self._number += 1
        if width >= stamp.BITS * stamp.BLOCK_PX:
            stamp.write(part, self._number, exposed_at)
        sent = as_sent(part, pixel_format)
        size = ctypes.c_size_t()
        # the size comes as 0 here: nothing has been received into this buffer yet
        start = _library.arv_buffer_get_data(buffer, ctypes.byref(size))
        memory = np.ctypeslib.as_array((ctypes.c_uint8 * sent.size).from_address(start))
        memory[:] = sent.reshape(-1)


def of_file(path: Path) -> Callable[[], Picture]:
    """Always the same picture."""
    read = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if read is None:
        raise SystemExit(f"{path} is not a picture that can be read")
    still = np.asarray(read, dtype=np.uint8)
    return lambda: still


class CellEye:
    """What an eye of the simulated cell sees now.

    Drawing takes a busy machine a second, in which the camera, which has one thread for all, answers nobody.
    So a picture is drawn only when arm, jaws or parts are elsewhere than in the last one; and while the arm
    moves all is black: a frame of that time must never be looked at.
    """

    def __init__(self, port: int, eye: str) -> None:
        self._clock = MonotonicClock()
        settings = SimCameraSettings.model_validate(
            {"driver": "sim", "port": port, "eye": eye, "width_px": 640, "height_px": 480}
        )
        self._camera = SimCamera(f"peer.{eye}", settings, self._clock)
        self._camera.open()
        self._onlooker = Link(f"peer.{eye}", settings.host, port, self._clock)
        self._onlooker.open()
        self._shown: tuple[str, Picture] | None = None

    def __call__(self) -> Picture:
        seen = self._places()
        if seen is None:
            return np.zeros((480, 640, 3), dtype=np.uint8)
        if self._shown is not None and self._shown[0] == seen:
            return self._shown[1]
        picture = self._camera.grab(newer_than=self._clock.now(), timeout_s=60.0).pixels
        self._shown = (seen, picture) if self._places() == seen else None
        return picture

    def _places(self) -> str | None:
        """Where everything stands; None while the arm moves."""
        arm = self._onlooker.ask("state", {}, 60.0)
        if arm.flag("moving"):
            return None
        joints = [round(q, 5) for q in arm.six("q_rad")]
        parts = self._onlooker.ask("truth", {}, 60.0).values
        jaws = self._onlooker.ask("grip", {}, 60.0).text("grip")
        return json.dumps([joints, parts, jaws])


def main() -> None:
    """Serve until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--address", required=True)
    parser.add_argument("--serial", required=True)
    parser.add_argument("--netns")
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--cell", type=int, help="port of the simulated cell")
    parser.add_argument("--eye", choices=["left", "right"], default="left")
    wanted = parser.parse_args()
    if (wanted.picture is None) == (wanted.cell is None):
        parser.error("one of --picture and --cell is needed")
    picture = of_file(wanted.picture) if wanted.cell is None else CellEye(wanted.cell, wanted.eye)
    if wanted.netns is not None:
        enter(wanted.netns)
    painter = Painter(picture)
    camera: Any = Aravis.GvFakeCamera.new_full(wanted.address, wanted.serial, None)
    if not camera.is_running():
        raise SystemExit(f"no camera could be started at {wanted.address}")
    # PyGObject frees a callback given to set_fill_pattern at once; hash() of its objects is their address
    _library.arv_fake_camera_set_fill_pattern(hash(camera.get_fake_camera()), painter.callback, None)
    loop = GLib.MainLoop()
    signal.signal(signal.SIGTERM, lambda *_: os._exit(0))
    print(json.dumps({"event": "listening", "address": wanted.address, "serial": wanted.serial}), flush=True)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    loop.run()


def _end_with_parent() -> None:
    """Standard input closes when whoever started this is gone."""
    sys.stdin.buffer.read()
    os._exit(0)


if __name__ == "__main__":
    main()
