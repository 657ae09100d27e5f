"""Two webcams at 30 Hz for a long time, in the virtual machine: no frame older or newer than it says, none
twice, every lost one counted, no leak. Some seconds among the other tests, half an hour by
``make soak-cameras``.

Pictures are small, 176x144: what takes the time is to decode them in an emulated machine, 53 ms one of
640x480 (`tests/lab/test_v4l2.py` has those, and counts what it loses).
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.lab.vm.machine import CannotStart
from tests.lab.vm.webcams import plugged_in

SHORT_MINUTES = 1.0 / 3.0
LEAST_RATE_HZ = 29.0
LEAST_SHARE = 0.8
MOST_AGE_S = 1.0
MOST_MEMORY_MB = 4.0


def test_frames_stay_new_and_nothing_grows(pytestconfig: pytest.Config, tmp_path: Path) -> None:
    asked: float | None = pytestconfig.getoption("--minutes")
    seconds = 60.0 * (SHORT_MINUTES if asked is None else asked)
    try:
        with plugged_in(tmp_path) as webcams:
            told = webcams.soak(seconds, timeout_s=seconds + 120.0)
    except CannotStart as reason:
        pytest.skip(f"V4L2 IS NOT TESTED: {reason}")
    cameras, memory_mb, files, threads = (told[key] for key in ("cameras", "memory_mb", "files", "threads"))
    took_s = float(str(told["took_s"]))
    assert isinstance(cameras, list)
    assert isinstance(memory_mb, list)
    assert isinstance(files, list)
    assert isinstance(threads, list)
    for has in cameras:
        print(
            f"\n{took_s:.0f} s: {has['exposed']} pictures ({has['exposed'] / took_s:.2f} Hz), driver: "
            f"{has['frames']} frames, {has['dropped']} dropped, {has['incomplete']} incomplete; "
            f"{has['handed_over']} handed over, age median {1e3 * has['age_median_s']:.1f} ms, "
            f"99 % {1e3 * has['age_99_s']:.1f} ms, largest {1e3 * has['age_largest_s']:.0f} ms; kernel's "
            f"stamp at most {1e3 * has['stamp_latest_s']:.1f} ms after the exposure"
        )
    print(
        f"{100 * float(str(told['cpu'])):.1f} % of an emulated core; memory {memory_mb[0]:.1f} to "
        f"{memory_mb[-1]:.1f} MB, largest {max(memory_mb):.1f}; {files[-1]} files, {threads[-1]} threads"
    )
    for has in cameras:
        assert has["unread"] == 0, "a spoilt frame was handed out"
        assert has["repeated"] == 0, "a frame came twice"
        assert has["too_new"] == 0, "it claims to be newer than it is"
        assert has["unknown"] == 0, "a frame whose exposure the camera does not know"
        assert has["age_largest_s"] <= MOST_AGE_S, "a stale frame"
        assert has["slipped"] == 0, "the kernel's number and the camera's went apart"
        assert has["accounted_for"] == has["exposed"], "a lost picture was not counted"
        assert has["sent_after_last"] == 0, "the last picture did not arrive"
        assert has["losses"] == 0
        assert has["exposed"] / took_s >= LEAST_RATE_HZ
        assert has["handed_over"] >= LEAST_SHARE * has["exposed"]
    assert max(memory_mb) - memory_mb[0] < MOST_MEMORY_MB
    assert max(files) <= files[0]
    assert max(threads) <= threads[0]
