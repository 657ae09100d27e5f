"""Networks and cameras of the GigE lab: what has to be there, made and removed again."""

from __future__ import annotations

import ctypes
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest

from drivers.camera_settings import GigeCameraSettings

ROOT: Final = Path(__file__).parents[2]
NETNS: Final = Path(__file__).with_name("netns.sh")
ADDRESSES: Final = {"left": "10.77.1.2", "right": "10.77.2.2"}
EYES: Final = ("left", "right")
_CLONE_NEWNET: Final = 0x40000000
_START_S: Final = 20.0


def missing() -> str | None:
    """What keeps this machine from running GigE Vision cameras; None when nothing does."""
    if os.geteuid() != 0:
        return "network namespaces are made by root"
    for tool in ("ip", "nft"):
        if shutil.which(tool) is None:
            return f"{tool} is not there: tests/lab/setup.sh installs it"
    if importlib.util.find_spec("gi") is None:
        return "PyGObject is not there: tests/lab/setup.sh installs it"
    try:
        ctypes.CDLL("libaravis-0.8.so.0")
    except OSError:
        return "Aravis is not there: tests/lab/setup.sh installs it"
    return None


def require() -> None:
    """Skip the test, and say why, where the cameras cannot be had."""
    lack = missing()
    if lack is not None:
        pytest.skip(f"GigE LAB NOT RUN: {lack}")


def _enter(path: Path) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    with path.open("rb") as held:
        if libc.setns(held.fileno(), _CLONE_NEWNET) != 0:
            raise OSError(ctypes.get_errno(), f"cannot enter {path}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Network:
    """``tag``-cell, in which this thread is, and the two places of the cameras."""

    tag: str

    def nft(self, eye: str, *words: str) -> None:
        """Filter what a camera sends."""
        subprocess.run(["ip", "netns", "exec", f"{self.tag}-{eye}", "nft", *words], check=True)

    def lose(self, eye: str, per_mille: int) -> None:
        """Of the packets with pictures in them, this many get lost from now on; 0: none."""
        self.nft(eye, "flush", "ruleset")
        if per_mille:
            self.nft(eye, "add table ip lab")
            self.nft(eye, "add chain ip lab out { type filter hook output priority 0; }")
            self.nft(
                eye,
                f"add rule ip lab out udp length > 600 numgen random mod 1000 < {per_mille} counter drop",
            )


@contextmanager
def network() -> Iterator[Network]:
    """Enter a cell's network that nobody else has. Threads and processes started meanwhile are in it."""
    tag = f"mik{os.getpid()}"
    subprocess.run([str(NETNS), "up", tag], check=True)
    home = Path(f"/proc/self/task/{_thread_id()}/ns/net")
    kept = os.open(home, os.O_RDONLY)
    try:
        _enter(Path("/var/run/netns", f"{tag}-cell"))
        yield Network(tag=tag)
    finally:
        _enter(Path(f"/proc/self/fd/{kept}"))
        os.close(kept)
        subprocess.run([str(NETNS), "down", tag], check=True)


def first_in_line(pid: int) -> None:
    """What stands for hardware does not wait for the programs under test: a camera has its own processor."""
    for task in Path(f"/proc/{pid}/task").iterdir():
        os.setpriority(os.PRIO_PROCESS, int(task.name), -15)


def _thread_id() -> int:
    return int(ctypes.CDLL(None).gettid())


class Peer:
    """One camera, a process in its own namespace, that can be killed, stopped and started again."""

    def __init__(self, net: Network, eye: str, *what: str) -> None:
        self._command = [
            *(sys.executable, "-m", "tests.lab.gige_camera", "--address", ADDRESSES[eye]),
            *("--serial", eye.upper(), "--netns", f"{net.tag}-{eye}", "--eye", eye, *what),
        ]
        self.eye = eye
        self.process = self._begin()

    def _begin(self) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            self._command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        first = process.stdout.readline()
        assert first, f"the camera process {self.eye} did not start"
        assert json.loads(first)["event"] == "listening"
        first_in_line(process.pid)
        return process

    def kill(self) -> None:
        """The cable is out, the power gone."""
        self.process.kill()
        self._over()

    def _over(self) -> None:
        self.process.wait(5.0)
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()

    def restart(self) -> None:
        """As after `kill`: the same camera again."""
        self.process = self._begin()

    def end(self) -> None:
        """Over."""
        if self.process.poll() is None:
            self.process.kill()
        self._over()


@contextmanager
def peer(net: Network, eye: str, *what: str) -> Iterator[Peer]:
    """One camera; ``--picture FILE`` or ``--cell PORT``."""
    running = Peer(net, eye, *what)
    try:
        yield running
    finally:
        running.end()


@contextmanager
def peers(net: Network, left: tuple[str, ...], right: tuple[str, ...]) -> Iterator[dict[str, Peer]]:
    """Both cameras; ``--picture FILE`` or ``--cell PORT`` each."""
    running: dict[str, Peer] = {}
    try:
        for eye, what in (("left", left), ("right", right)):
            running[eye] = Peer(net, eye, *what)
        yield running
    finally:
        for peer in running.values():
            peer.end()


def settings(eye: str, **changes: object) -> GigeCameraSettings:
    """A camera of the lab, by address, at 15 Hz."""
    return GigeCameraSettings.model_validate(
        {
            "driver": "gige",
            "address": ADDRESSES[eye],
            "width_px": 640,
            "height_px": 480,
            "exposure_us": 5000,
            "trigger": "free",
            "rate_hz": 15,
            "packet_size": 8000,
            "lag_s": 0.2,  # its process waits its turn on a busy machine
            **changes,
        }
    )


def wait_until(condition: object, within_s: float, what: str) -> float:
    """Seconds until a condition held."""
    assert callable(condition)
    began_at = time.monotonic()
    while not condition():
        assert time.monotonic() - began_at < within_s, f"not within {within_s:g} s: {what}"
        time.sleep(0.005)
    return time.monotonic() - began_at
