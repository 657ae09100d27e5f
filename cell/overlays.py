"""One overlay picture per look, written by a thread of its own: drawing must never slow a pick."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2

from cell.logs import logger
from cell.station import Look
from cell.workers import Beat, Mailbox, MailboxFull
from drivers.timing import StopToken
from vision.draw import draw
from vision.types import StereoModel

log = logger("overlays")

_KEPT: Final = 500
_WAITING: Final = 4


class OverlayWriter:
    """Draws looks into a folder, keeps the newest `_KEPT`; drops a look rather than wait."""

    def __init__(self, folder: Path, stereo: StereoModel, stop: StopToken, beat: Beat) -> None:
        self._folder = folder
        self._stereo = stereo
        self._stop = stop
        self._beat = beat
        self._waiting: Mailbox[Look] = Mailbox(_WAITING)

    def put(self, look: Look) -> None:
        """Hand in a look; from any one thread."""
        try:
            self._waiting.put(look)
        except MailboxFull:
            log.warning("overlay_dropped", request_id=look.order.request_id)

    def run(self) -> None:
        """Until the token fires; what waits is still written."""
        while True:
            self._beat()
            look = self._waiting.take(0.0 if self._stop.stopped else 0.2)
            if look is not None:
                self._write(look)
            elif self._stop.stopped:
                return

    def _write(self, look: Look) -> None:
        name = f"look-{look.pair.left.sequence:06d}-order-{look.order.request_id:05d}.png"
        try:
            among = tuple(part.model() for part in look.among)
            picture = draw(look.pair.left.pixels, look.scene, self._stereo, look.part.model(), among)
            self._folder.mkdir(parents=True, exist_ok=True)
            done, encoded = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            if not done:
                raise OSError("the picture could not be encoded")
            (self._folder / name).write_bytes(encoded.tobytes())
            # by time, because a camera counts its pictures from 1 again after every start
            written = sorted(self._folder.glob("look-*.png"), key=lambda file: file.stat().st_mtime_ns)
            for old in written[:-_KEPT]:
                old.unlink()
        except (OSError, ValueError, cv2.error) as error:
            # a picture that cannot be drawn or kept must not end the cell
            log.warning("overlay_not_written", file=str(self._folder / name), detail=str(error))
