"""A camera that is lost and found again. The source is scripted; the owner's thread is real."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from drivers.camera.life import Bell, CameraState, Life, OwnedCamera
from drivers.camera.source import Counters
from drivers.errors import CommandRejected, DeviceTimeout, DeviceUnavailable
from drivers.timing import MonotonicClock
from drivers.types import Frame

CLOCK = MonotonicClock()
LIFE = Life(period_s=0.01, lost_s=0.3, good_frames=2, open_s=2.0, backoff_s=(0.01, 0.04), idle_s=0.1)


class ScriptedSource:
    """Frames that the test hands over; starts that fail as told."""

    name = "camera.left"

    def __init__(self) -> None:
        self.frames: queue.Queue[Frame | Exception] = queue.Queue()
        self.start_errors: list[Exception] = []
        self.starts = 0
        self.stops = 0
        self.streaming = False
        self.live = True  # a frame whenever none was handed over
        self.threads: set[int] = set()
        self.triggers = 0
        self._sequence = 0
        self._never = threading.Event()

    def make(self, captured_at: float) -> Frame:
        self._sequence += 1
        pixels = np.zeros((2, 2), dtype=np.uint8)
        return Frame(camera=self.name, pixels=pixels, captured_at=captured_at, sequence=self._sequence)

    def start(self) -> None:
        self.threads.add(threading.get_ident())
        self.starts += 1
        if self.start_errors:
            raise self.start_errors.pop(0)
        self.streaming = True

    def next(self, timeout_s: float) -> Frame | None:
        self.threads.add(threading.get_ident())
        assert self.streaming
        try:
            given = self.frames.get(timeout=0.005 if self.live else timeout_s)
        except queue.Empty:
            return self.make(CLOCK.now()) if self.live else None
        if isinstance(given, Exception):
            raise given
        return given

    def trigger(self) -> None:
        self.threads.add(threading.get_ident())
        self.triggers += 1

    def stop(self) -> None:
        self.stops += 1
        self.streaming = False

    def counters(self) -> Counters:
        return Counters()


@pytest.fixture
def source() -> ScriptedSource:
    return ScriptedSource()


@pytest.fixture
def camera(source: ScriptedSource) -> Iterator[OwnedCamera]:
    made = OwnedCamera(source, LIFE, CLOCK)
    yield made
    made.close()


def until(condition: Callable[[], bool]) -> None:
    ends_at = CLOCK.now() + 5.0
    pause = threading.Event()
    while not condition():
        assert CLOCK.now() < ends_at
        pause.wait(0.002)


def test_one_thread_owns_the_source_from_start_to_stop(camera: OwnedCamera, source: ScriptedSource) -> None:
    camera.open()
    camera.grab(newer_than=CLOCK.now(), timeout_s=1.0)
    camera.close()
    assert len(source.threads) == 1
    assert threading.get_ident() not in source.threads
    assert not source.streaming


def test_what_start_refuses_is_raised_by_open_and_nothing_stays(
    camera: OwnedCamera, source: ScriptedSource
) -> None:
    source.start_errors = [CommandRejected("camera.left", "exposure us: 5 was asked for")]
    with pytest.raises(CommandRejected, match="exposure us"):
        camera.open()
    assert camera.status().state is CameraState.CLOSED
    assert not source.streaming


def test_a_camera_without_frames_does_not_open(camera: OwnedCamera, source: ScriptedSource) -> None:
    source.live = False
    with pytest.raises(DeviceUnavailable, match=r"no frame for 0\.3 s"):
        camera.open()


def test_a_frame_as_old_as_asked_for_is_not_handed_out(camera: OwnedCamera, source: ScriptedSource) -> None:
    camera.open()
    last = camera.grab(newer_than=CLOCK.now(), timeout_s=1.0)
    source.live = False
    until(lambda: source.frames.empty())
    exact = source.make(last.captured_at + 100.0)
    source.frames.put(exact)
    assert camera.grab(newer_than=last.captured_at + 99.0, timeout_s=100.0) is exact
    with pytest.raises(DeviceTimeout):
        camera.grab(newer_than=exact.captured_at, timeout_s=0.02)


def test_a_lost_camera_is_said_at_once_also_to_who_waits(camera: OwnedCamera, source: ScriptedSource) -> None:
    camera.open()
    source.live = False
    source.start_errors = [DeviceUnavailable("camera.left", "not there")] * 1000
    source.frames.put(DeviceUnavailable("camera.left", "unplugged"))
    asked_at = CLOCK.now()
    with pytest.raises(DeviceUnavailable, match="lost"):
        camera.grab(newer_than=asked_at + 1.0, timeout_s=5.0)
    assert CLOCK.now() - asked_at < 1.0
    with pytest.raises(DeviceUnavailable):
        camera.check()
    asked_at = CLOCK.now()
    with pytest.raises(DeviceUnavailable):
        camera.grab(newer_than=asked_at, timeout_s=5.0)
    assert CLOCK.now() - asked_at < 0.1


def test_silence_makes_it_suspect_then_lost_and_it_comes_back_with_good_frames(
    camera: OwnedCamera, source: ScriptedSource
) -> None:
    camera.open()
    source.live = False
    until(lambda: camera.status().state is CameraState.SUSPECT)
    camera.check()  # a hiccup takes no permission away
    until(lambda: camera.status().losses == 1)
    starts = source.starts
    source.live = True
    until(lambda: camera.status().state is CameraState.READY)
    assert source.starts > starts - 1
    assert source.stops >= 1
    assert camera.grab(newer_than=CLOCK.now(), timeout_s=1.0).captured_at > 0.0


def test_a_hiccup_is_over_with_the_next_frame(camera: OwnedCamera, source: ScriptedSource) -> None:
    camera.open()
    starts = source.starts
    source.live = False
    until(lambda: camera.status().state is CameraState.SUSPECT)
    source.live = True
    until(lambda: camera.status().state is CameraState.READY)
    assert source.starts == starts


def test_a_driver_that_fails_is_a_lost_camera_and_not_one_that_looks_ready(
    camera: OwnedCamera, source: ScriptedSource
) -> None:
    camera.open()
    source.frames.put(ZeroDivisionError("a bug"))
    until(lambda: camera.status().state is CameraState.LOST)
    with pytest.raises(DeviceUnavailable, match="a bug"):
        camera.check()


def test_an_owner_that_hangs_is_noticed_by_who_asks(camera: OwnedCamera, source: ScriptedSource) -> None:
    camera.open()
    hold = threading.Event()

    def hang(timeout_s: float) -> Frame | None:
        hold.wait(10.0)
        return None

    source.next = hang  # type: ignore[method-assign]

    def refused() -> bool:
        try:
            camera.check()
        except DeviceUnavailable as error:
            return "has not moved" in str(error)
        return False

    until(refused)
    hold.set()


def test_cameras_that_share_a_bell_are_triggered_together_by_one_request() -> None:
    bell, sources = Bell(), [ScriptedSource(), ScriptedSource()]
    life = Life(period_s=0.01, lost_s=5.0, good_frames=1, idle_s=60.0)
    cameras = [OwnedCamera(s, life, CLOCK, s.trigger, bell) for s in sources]
    for one in cameras:
        one.open()
    before = [s.triggers for s in sources]
    asked_at = CLOCK.now()
    frame = cameras[0].grab(newer_than=asked_at, timeout_s=2.0)
    until(lambda: all(s.triggers > b for s, b in zip(sources, before, strict=True)))
    other = cameras[1].grab(newer_than=asked_at, timeout_s=2.0)
    for one in cameras:
        one.close()
    assert frame.captured_at > asked_at
    assert other.captured_at > asked_at
