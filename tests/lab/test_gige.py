"""Two GigE Vision cameras over a real network: what is seen, and what happens when one dies, hangs or loses
packets. The instants drawn into the pictures say whether a frame is what it claims to be."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.camera.life import CameraState, OwnedCamera
from drivers.errors import CommandRejected, DeviceUnavailable
from drivers.factory import Factory
from drivers.interfaces import Camera
from drivers.timing import MonotonicClock
from tests.lab import gige, stamp
from tests.lab.gige import Network, Peer

CLOCK = MonotonicClock()
DATA = Path(__file__).parents[1] / "data"
LOST_WITHIN_S = 2.5
BACK_WITHIN_S = 20.0


@pytest.fixture(scope="module")
def net() -> Iterator[Network]:
    gige.require()
    with gige.network() as made:
        yield made


@pytest.fixture(scope="module")
def eyes(net: Network) -> Iterator[dict[str, Peer]]:
    left, right = (("--picture", str(DATA / f"{eye}.png")) for eye in gige.EYES)
    with gige.peers(net, left, right) as running:
        yield running


@contextmanager
def camera(eye: str = "left", **changes: object) -> Iterator[OwnedCamera]:
    made: Camera = Factory(CLOCK).camera(f"camera.{eye}", gige.settings(eye, **changes))
    assert isinstance(made, OwnedCamera)
    made.open()
    try:
        yield made
    finally:
        made.close()


def test_a_pair_shows_what_the_cameras_show_and_is_as_new_and_as_near_as_it_says(
    eyes: dict[str, Peer],
) -> None:
    left, right = (gige.settings(eye, trigger="software") for eye in gige.EYES)
    rig = Factory(CLOCK).rig(left, right, 0.04)
    rig.open()
    try:
        skews = []
        for _ in range(10):
            asked_at = CLOCK.now()
            pair = rig.grab_pair(newer_than=asked_at, timeout_s=5.0)
            stamps = [stamp.read(frame.pixels) for frame in (pair.left, pair.right)]
            for frame, told in zip((pair.left, pair.right), stamps, strict=True):
                assert told is not None
                assert asked_at < frame.captured_at <= told.exposed_at + 1e-4
            assert stamps[0] is not None
            assert stamps[1] is not None
            skews.append(abs(stamps[0].exposed_at - stamps[1].exposed_at))
        print(f"\ntrue skew, triggered by software: median {1e3 * float(np.median(skews)):.1f} ms")
        assert float(np.median(skews)) < 0.04
    finally:
        rig.close()


@pytest.mark.parametrize("pixel_format", ["Mono8", "Mono16", "BayerRG8", "BayerGR8", "RGB8"])
def test_every_format_shows_the_same_scene(eyes: dict[str, Peer], pixel_format: str) -> None:
    truth = cv2.imread(str(DATA / "left.png"), cv2.IMREAD_COLOR)
    assert truth is not None
    with camera(pixel_format=pixel_format) as made:
        frame = made.grab(newer_than=CLOCK.now(), timeout_s=5.0)
    seen = frame.pixels if frame.pixels.ndim == 3 else cv2.cvtColor(frame.pixels, cv2.COLOR_GRAY2BGR)
    if frame.pixels.ndim == 2:
        truth = cv2.cvtColor(cv2.cvtColor(truth, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    inner = np.s_[4:356, 4:476]  # the picture without the mosaic's rim
    assert float(np.abs(seen[inner].astype(float) - truth[inner]).mean()) < 3.0


def test_a_part_of_the_sensor_and_the_exposure_are_what_was_asked_for(eyes: dict[str, Peer]) -> None:
    with camera(offset_x_px=64, offset_y_px=32, width_px=320, height_px=240) as made:
        part = made.grab(newer_than=CLOCK.now(), timeout_s=5.0).pixels
    with camera() as made:
        whole = made.grab(newer_than=CLOCK.now(), timeout_s=5.0).pixels
    with camera(exposure_us=2500) as made:
        dark = made.grab(newer_than=CLOCK.now(), timeout_s=5.0).pixels
    assert np.array_equal(part, whole[32:272, 64:384])
    assert float(dark[:470].mean()) == pytest.approx(float(whole[:470].mean()) / 2.0, rel=0.05)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"exposure_us": 5.0}, "ExposureTime"),
        ({"gain": 99.0}, "Gain"),
        ({"pixel_format": "Mono12"}, "Mono12"),
        ({"width_px": 9999}, "Width"),
        ({"trigger": "Line7"}, "Line7"),
    ],
)
def test_what_a_camera_cannot_do_is_refused_by_name(
    eyes: dict[str, Peer], changes: dict[str, Any], said: str
) -> None:
    with pytest.raises(CommandRejected, match=said), camera("left", **changes):
        pass


def test_a_camera_is_found_by_its_serial_number_and_another_one_is_not(eyes: dict[str, Peer]) -> None:
    with camera("right", address=None, serial="RIGHT") as made:
        assert made.grab(newer_than=CLOCK.now(), timeout_s=5.0).pixels.shape == (480, 640)
    with pytest.raises(DeviceUnavailable, match=r"there are: .*LEFT"), camera(address=None, serial="NOBODY"):
        pass


def test_the_list_of_cameras_names_each_by_serial_number_and_address(eyes: dict[str, Peer]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "cell", "camera", "list"],
        cwd=gige.ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=60.0,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for eye in gige.EYES:
        assert f"driver: gige, serial: {eye.upper()}\n  also address: {gige.ADDRESSES[eye]}\n" in done.stdout


def test_a_second_program_is_told_that_the_camera_is_held(eyes: dict[str, Peer]) -> None:
    with camera(), pytest.raises(DeviceUnavailable, match="held by another program"), camera():
        pass


def test_a_killed_camera_is_lost_in_time_and_comes_back_with_its_settings(eyes: dict[str, Peer]) -> None:
    with camera(exposure_us=2500) as made:
        before = made.grab(newer_than=CLOCK.now(), timeout_s=5.0)
        eyes["left"].kill()
        lost_s = gige.wait_until(lambda: _lost(made), LOST_WITHIN_S, "lost")
        asked_at = CLOCK.now()
        with pytest.raises(DeviceUnavailable):
            made.grab(newer_than=asked_at, timeout_s=5.0)
        assert CLOCK.now() - asked_at < 0.2
        eyes["left"].restart()
        back_s = gige.wait_until(
            lambda: made.status().state is CameraState.READY, BACK_WITHIN_S, "ready again"
        )
        after = made.grab(newer_than=CLOCK.now(), timeout_s=5.0)
        told = stamp.read(after.pixels)
        assert told is not None
        assert after.captured_at <= told.exposed_at + 1e-4
        assert after.sequence > before.sequence
        assert float(after.pixels[:470].mean()) == pytest.approx(float(before.pixels[:470].mean()), rel=0.02)
    print(f"\nlost {lost_s:.2f} s after the kill, ready {back_s:.2f} s after the restart")


def _lost(made: OwnedCamera) -> bool:
    try:
        made.check()
    except DeviceUnavailable:
        return True
    return False


def test_a_stall_of_a_second_and_a_half_takes_the_permission_and_heals(eyes: dict[str, Peer]) -> None:
    with camera() as made:
        made.grab(newer_than=CLOCK.now(), timeout_s=5.0)
        os.kill(eyes["left"].process.pid, signal.SIGSTOP)
        try:
            gige.wait_until(lambda: _lost(made), 1.5, "lost")
            time.sleep(0.5)
        finally:
            os.kill(eyes["left"].process.pid, signal.SIGCONT)
        back_s = gige.wait_until(
            lambda: made.status().state is CameraState.READY, BACK_WITHIN_S, "ready again"
        )
        asked_at = CLOCK.now()
        told = stamp.read(made.grab(newer_than=asked_at, timeout_s=5.0).pixels)
        assert told is not None
        assert told.exposed_at > asked_at - 0.02
    print(f"\nready {back_s:.2f} s after the stall")


def test_a_heartbeat_that_is_not_answered_is_a_loss_and_again_and_again_harms_nobody(
    eyes: dict[str, Peer],
) -> None:
    with camera(lost_s=30.0, trigger="software") as made:
        for losses in (1, 2):
            os.kill(eyes["left"].process.pid, signal.SIGSTOP)
            try:
                gige.wait_until(lambda: _lost(made), 15.0, "lost")
                reason = made.status().reason
            finally:
                os.kill(eyes["left"].process.pid, signal.SIGCONT)
            gige.wait_until(lambda: made.status().state is CameraState.READY, BACK_WITHIN_S, "ready again")
            assert "control lost" in reason or "timeout" in reason
            assert made.status().losses == losses


@pytest.mark.parametrize(("per_mille", "packet_size"), [(1, 1400), (10, 8000)])
def test_frames_with_missing_packets_are_counted_and_never_handed_out(
    net: Network, eyes: dict[str, Peer], per_mille: int, packet_size: int
) -> None:
    with camera(rate_hz=30, packet_size=packet_size) as made:
        net.lose("left", per_mille)
        try:
            first = made.status().counters
            spoilt, seen, newest = 0, 0, -1.0
            ends_at = CLOCK.now() + 5.0
            while CLOCK.now() < ends_at:
                frame = made.grab(newer_than=newest, timeout_s=2.0)
                newest, seen = frame.captured_at, seen + 1
                spoilt += stamp.read(frame.pixels) is None
            last = made.status().counters
        finally:
            net.lose("left", 0)
        assert spoilt == 0
        assert last.incomplete > first.incomplete
        print(
            f"\n{per_mille} of 1000 packets of {packet_size} lost: {seen} whole frames, "
            f"{last.incomplete - first.incomplete} thrown away"
        )
