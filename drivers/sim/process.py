"""How a simulated device ends: asked by a signal, at the moment it chooses."""

from __future__ import annotations

import signal
import socket
from typing import Final

ENDING: Final = (signal.SIGTERM, signal.SIGINT)


def ending_signals() -> socket.socket:
    """A socket that can be read once the process was asked to end.

    A handler that sets an event could meet the main thread inside that event's lock, and masks do not reach
    the threads numpy starts; a byte written by the interpreter's own handler always arrives.
    """
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    for number in ENDING:
        signal.signal(number, lambda *_: None)
    signal.set_wakeup_fd(writer.detach())
    return reader
