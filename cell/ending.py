"""Says when somebody asked the process to end, without running any code inside a signal.

A handler that sets an event can meet its own thread inside that event's lock, and CPython 3.11's
``signal.sigtimedwait`` answers with a made-up signal after the process was frozen and continued. So the
interpreter only writes the signal's number into a pipe, and the main thread waits on that.
"""

from __future__ import annotations

import select
import signal
import socket
from types import FrameType, TracebackType
from typing import Final, Self

ENDING: Final = (signal.SIGTERM, signal.SIGINT)


class EndRequest:
    """Between ``with`` and its end, SIGTERM and SIGINT are waited for. Main thread only."""

    def __enter__(self) -> Self:
        self._reader, self._writer = socket.socketpair()
        self._reader.setblocking(False)
        self._writer.setblocking(False)
        self._before = {number: signal.getsignal(number) for number in ENDING}
        self._descriptor = signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)
        for number in ENDING:
            signal.signal(number, _noted)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._descriptor)
        self._reader.close()
        self._writer.close()

    def wait(self, timeout_s: float) -> bool:
        """True when one of them came, now or since the last call; False when the time is over."""
        ready, _, _ = select.select([self._reader], [], [], timeout_s)
        return bool(ready) and any(number in ENDING for number in self._reader.recv(64))


def _noted(_number: int, _frame: FrameType | None) -> None:
    """The byte in the pipe is all there is to do."""
