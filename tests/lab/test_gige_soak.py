"""Two GigE Vision cameras for a long time: no frame older or newer than it says, none twice, no leak. Some
seconds among the other tests, half an hour by ``make soak-cameras``."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from drivers.factory import Factory
from drivers.timing import MonotonicClock
from tests.lab import gige, stamp

CLOCK = MonotonicClock()
DATA = Path(__file__).parents[1] / "data"
SHORT_MINUTES = 1.0 / 3.0
RATE_HZ = 30.0
MOST_AGE_S = 1.0
MOST_MEMORY_MB = 12.0
WARM = 0.25
"""This share of the time passes before the first sample of memory counts."""


def memory_mb() -> float:
    status = Path("/proc/self/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")) / 1024.0


def test_frames_stay_new_and_nothing_grows(pytestconfig: pytest.Config) -> None:
    gige.require()
    asked: float | None = pytestconfig.getoption("--minutes")
    seconds = 60.0 * (SHORT_MINUTES if asked is None else asked)
    left, right = (("--picture", str(DATA / f"{eye}.png")) for eye in gige.EYES)
    with gige.network() as net, gige.peers(net, left, right):
        cameras = [
            Factory(CLOCK).camera(f"camera.{eye}", gige.settings(eye, rate_hz=RATE_HZ, lost_s=3.0))
            for eye in gige.EYES
        ]
        for camera in cameras:
            camera.open()
        try:
            newest, numbers, frames = [-1.0, -1.0], [0, 0], [0, 0]
            ages: list[float] = []
            began_at, cpu_at = time.monotonic(), time.process_time()
            first_mb, first_files, first_threads = 0.0, 0, 0
            while (passed_s := time.monotonic() - began_at) < seconds:
                for i, camera in enumerate(cameras):
                    frame = camera.grab(newer_than=newest[i], timeout_s=5.0)
                    seen_at = time.monotonic()
                    told = stamp.read(frame.pixels)
                    assert told is not None, "a spoilt frame was handed out"
                    assert told.number > numbers[i], "a frame came twice"
                    assert frame.captured_at <= told.exposed_at + 1e-3, "it claims to be newer than it is"
                    ages.append(seen_at - told.exposed_at)
                    newest[i], numbers[i], frames[i] = frame.captured_at, told.number, frames[i] + 1
                if not first_mb and passed_s > WARM * seconds:
                    first_mb, first_files = memory_mb(), len(list(Path("/proc/self/fd").iterdir()))
                    first_threads = threading.active_count()
            cpu = (time.process_time() - cpu_at) / (time.monotonic() - began_at)
            last_mb, last_files = memory_mb(), len(list(Path("/proc/self/fd").iterdir()))
            ages.sort()
            held = sum(age > MOST_AGE_S for age in ages)
            middle, late = (1e3 * ages[int(len(ages) * share)] for share in (0.5, 0.99))
            print(
                f"\n{seconds:.0f} s: {frames[0]} + {frames[1]} of {numbers[0]} + {numbers[1]} frames; "
                f"age at hand-over median {middle:.1f} ms, 99 % {late:.1f} ms, "
                f"largest {1e3 * ages[-1]:.0f} ms, {held} later than {MOST_AGE_S:g} s; "
                f"{100 * cpu:.1f} % of a core; memory {first_mb:.1f} to {last_mb:.1f} MB"
            )
            assert held == 0, "a stale frame"
            assert last_mb - first_mb < MOST_MEMORY_MB
            assert last_files <= first_files
            assert threading.active_count() <= first_threads
        finally:
            for camera in cameras:
                camera.close()
