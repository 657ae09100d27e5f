"""Rules for every test: no thread outlives it, nobody else is talked to, logs are set up afresh."""

from __future__ import annotations

import ipaddress
import socket
import threading
import time
from collections.abc import Iterator

import pytest
import structlog

_END_S = 2.0
"""Threads that were told to end get this long to do so."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """What the tests in `tests/lab` can be asked for."""
    parser.addoption("--picks", type=int, help="parts a soak in tests/lab delivers (short by default)")
    parser.addoption(
        "--minutes", type=float, help="how long a soak of cameras in tests/lab takes (20 s by default)"
    )


@pytest.fixture(autouse=True)
def no_stray_threads() -> Iterator[None]:
    """Fail a test that leaves a thread behind; threads of module fixtures are not its own."""
    before = set(threading.enumerate())
    yield
    ends_at = time.monotonic() + _END_S
    stray = [thread for thread in threading.enumerate() if thread not in before]
    for thread in stray:
        thread.join(max(0.0, ends_at - time.monotonic()))
    left = sorted(thread.name for thread in stray if thread.is_alive())
    if left:
        pytest.fail(f"threads left running: {', '.join(left)}")


@pytest.fixture(autouse=True)
def fresh_logging() -> Iterator[None]:
    """Undo what a test set up for logs: its stream is closed when it ends."""
    yield
    structlog.reset_defaults()


def is_local(family: int, address: object) -> bool:
    """True for this machine's own addresses, and for families that never leave it."""
    if family not in (socket.AF_INET, socket.AF_INET6):
        return True
    host = address[0] if isinstance(address, tuple) and address else ""
    if host in ("localhost", b"localhost", ""):
        return True
    try:
        return ipaddress.ip_address(host.decode() if isinstance(host, bytes) else str(host)).is_loopback
    except ValueError:
        return False  # a name: looking it up would already ask somebody


@pytest.fixture(autouse=True)
def loopback_only(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Fail a test that talks to another host, also when the code under test swallows the refusal."""
    refused: list[str] = []
    connect, connect_ex, sendto = socket.socket.connect, socket.socket.connect_ex, socket.socket.sendto

    def check(own: socket.socket, address: object) -> None:
        if not is_local(own.family, address):
            refused.append(str(address))
            raise OSError(f"tests talk to this machine only, not to {address}")

    def guarded_connect(own: socket.socket, address: tuple[str, int]) -> None:
        check(own, address)
        connect(own, address)

    def guarded_connect_ex(own: socket.socket, address: tuple[str, int]) -> int:
        check(own, address)
        return connect_ex(own, address)

    def guarded_sendto(own: socket.socket, data: bytes, *rest: int | tuple[str, int] | str | bytes) -> int:
        check(own, rest[-1])
        return sendto(own, data, *rest)  # type: ignore[arg-type]  # as the caller gave them

    monkeypatch.setattr(socket.socket, "connect", guarded_connect)
    monkeypatch.setattr(socket.socket, "connect_ex", guarded_connect_ex)
    monkeypatch.setattr(socket.socket, "sendto", guarded_sendto)
    yield
    if refused:
        pytest.fail(f"a test reached out to {', '.join(refused)}")
