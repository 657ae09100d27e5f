"""A cable between two sockets that can be pulled: one TCP port that leads to another."""

from __future__ import annotations

import selectors
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_RESET = struct.pack("ii", 1, 0)
"""SO_LINGER 1, 0 s: close answers with RST, as a host does that knows nothing of the connection."""


class Cable:
    """Leads ``port`` to ``target`` while it is plugged in; a thread of its own carries the bytes."""

    def __init__(self, target: int) -> None:
        self._target = target
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self.port = int(self._listener.getsockname()[1])
        self._ends: dict[socket.socket, socket.socket] = {}
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._wake, self._woken = socket.socketpair()
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._plugged = True
        self._silent = False
        self._cut = False
        self._over = False
        self._thread = threading.Thread(target=self._carry, name="cable")
        self._thread.start()

    def pull(self) -> None:
        """Everything is cut with RST, and new connections are, too."""
        self._plugged, self._cut = False, True
        self._wake.send(b".")

    def swallow(self) -> None:
        """As a switch that has died: connections stay, bytes do not arrive."""
        self._silent = True

    def plug(self) -> None:
        """Whole again; what was swallowed is not sent after."""
        was_silent, self._silent = self._silent, False
        self._plugged = True
        self._cut = was_silent  # a stream with a hole in it is no stream
        self._wake.send(b".")

    def end(self) -> None:
        self._over = True
        self._wake.send(b".")
        self._thread.join(5.0)
        for each in (self._listener, self._wake, self._woken):
            each.close()
        self._selector.close()

    def _carry(self) -> None:
        while not self._over:
            for key, _ in self._selector.select(0.5):
                end = key.fileobj
                if end is self._woken:
                    self._woken.recv(64)
                elif end is self._listener:
                    self._accept()
                else:
                    assert isinstance(end, socket.socket)
                    self._pass_on(end)
            if self._cut:
                self._cut = False
                for end in list(self._ends):
                    self._drop(end)
        for end in list(self._ends):
            self._drop(end)

    def _accept(self) -> None:
        near, _ = self._listener.accept()
        try:
            if not self._plugged:
                raise ConnectionRefusedError
            far = socket.create_connection(("127.0.0.1", self._target), timeout=1.0)
        except OSError:
            near.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            near.close()
            return
        for one, other in ((near, far), (far, near)):
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._ends[one] = other
            self._selector.register(one, selectors.EVENT_READ)

    def _pass_on(self, end: socket.socket) -> None:
        other = self._ends.get(end)
        if other is None:
            return
        try:
            data = end.recv(65536)
            if not data:
                raise ConnectionResetError
            if not self._silent:
                other.sendall(data)
        except OSError:
            self._drop(end)

    def _drop(self, end: socket.socket) -> None:
        other = self._ends.pop(end, None)
        for each in (end, other):
            if each is None or each.fileno() < 0:
                continue
            self._ends.pop(each, None)
            self._selector.unregister(each)
            with suppress(OSError):
                each.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            each.close()


@contextmanager
def cable(target: int) -> Iterator[Cable]:
    """A cable that is taken away when the context ends."""
    laid = Cable(target)
    try:
        yield laid
    finally:
        laid.end()
