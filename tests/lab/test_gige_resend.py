"""Lost packets asked for again, against a camera that can send them again and is not Aravis' own."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from drivers.camera.life import OwnedCamera
from drivers.factory import Factory
from drivers.timing import MonotonicClock
from tests.lab import gige
from tests.lab.gige import Network

CLOCK = MonotonicClock()
KEPT_BACK = 20
FRAMES = 40
ROOM = 2
"""On a busy machine an answer may come too late, and its frame is thrown away."""


@pytest.fixture(scope="module")
def net() -> Iterator[Network]:
    gige.require()
    if importlib.util.find_spec("viva_genicam") is None:
        pytest.skip("GigE RESEND NOT RUN: viva-genicam is not there: tests/lab/setup.sh installs it")
    with gige.network() as made:
        yield made


@contextmanager
def peer(net: Network) -> Iterator[None]:
    command = [
        *("ip", "netns", "exec", f"{net.tag}-left", sys.executable, "-m", "tests.lab.gige_resend_camera"),
        *("--address", gige.ADDRESSES["left"], "--keep-back", str(KEPT_BACK)),
    ]
    with subprocess.Popen(
        command, cwd=gige.ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline(), "the camera process did not start"
            yield
        finally:
            process.kill()


@pytest.mark.parametrize("resend", [True, False])
def test_kept_back_packets_come_when_they_are_asked_for_and_spoil_frames_when_they_are_not(
    net: Network, resend: bool
) -> None:
    settings = gige.settings("left", resend=resend, rate_hz=20, packet_size=1400, lost_s=5.0)
    with peer(net):
        made = Factory(CLOCK).camera("camera.left", settings)
        assert isinstance(made, OwnedCamera)
        made.open()
        try:
            newest, seen = -1.0, 0
            while seen < FRAMES:
                frame = made.grab(newer_than=newest, timeout_s=5.0)
                newest, seen = frame.captured_at, seen + 1
                assert frame.pixels.shape == (480, 640)
            counted = made.status().counters
        finally:
            made.close()
    print(f"\nresend {'on' if resend else 'off'}: {counted}")
    if resend:
        assert counted.resent >= KEPT_BACK - ROOM
        assert counted.incomplete <= ROOM
    else:
        assert counted.resent == 0
        assert counted.incomplete >= KEPT_BACK
