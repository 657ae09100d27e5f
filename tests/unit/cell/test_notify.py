"""Messages to the service manager, read from a real socket."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from cell.notify import Notifier


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """A service manager's end of the socket, its path with an @ inside as an instance unit may have."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
        folder = tmp_path / "cell@a"
        folder.mkdir()
        own.bind(str(folder / "notify"))
        own.settimeout(5.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(folder / "notify"))
        yield own


def test_the_manager_hears_ready_status_life_and_the_end(manager: socket.socket) -> None:
    notifier = Notifier()
    notifier.ready("running")
    notifier.status("idle, 3 picked")
    notifier.alive()
    notifier.stopping()
    notifier.close()
    assert [manager.recv(200).decode() for _ in range(4)] == [
        "READY=1\nSTATUS=running",
        "STATUS=idle, 3 picked",
        "WATCHDOG=1",
        "STOPPING=1\nSTATUS=stopping",
    ]


def test_an_abstract_socket_is_reached_too(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
        own.bind("")  # the kernel chooses an abstract name
        own.settimeout(5.0)
        name = own.getsockname()
        assert isinstance(name, bytes)
        monkeypatch.setenv("NOTIFY_SOCKET", "@" + name[1:].decode())
        notifier = Notifier()
        notifier.alive()
        notifier.close()
        assert own.recv(100) == b"WATCHDOG=1"


def test_without_a_manager_nothing_is_sent_and_nothing_breaks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    notifier = Notifier()
    notifier.ready("running")
    notifier.close()
    notifier.close()


def test_a_manager_that_is_gone_does_not_end_the_daemon(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "nobody"))
    notifier = Notifier()
    notifier.alive()
    notifier.alive()
    notifier.close()
