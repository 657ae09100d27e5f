"""A request to end is noticed at once, kept until it is asked for, and nothing else is taken for one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from cell.ending import ENDING, EndRequest

REPOSITORY = Path(__file__).parents[3]


def test_without_a_signal_the_time_runs_out() -> None:
    with EndRequest() as asked:
        assert not asked.wait(0.0)


@pytest.mark.parametrize("number", ENDING)
def test_a_signal_is_kept_until_it_is_asked_for(number: signal.Signals) -> None:
    with EndRequest() as asked:
        os.kill(os.getpid(), number)
        assert asked.wait(5.0)
        assert not asked.wait(0.0)


def test_a_signal_from_another_thread_wakes_the_waiting_one() -> None:
    with EndRequest() as asked:
        sender = threading.Thread(target=os.kill, args=(os.getpid(), signal.SIGTERM))
        sender.start()
        assert asked.wait(5.0)
        sender.join()


def test_afterwards_signals_do_what_they_did_before() -> None:
    before = [signal.getsignal(number) for number in ENDING]
    with EndRequest():
        pass
    assert [signal.getsignal(number) for number in ENDING] == before


FROZEN = """
import os, signal, subprocess, sys
from cell.ending import EndRequest

with EndRequest() as asked:
    # somebody freezes this process for longer than it waits, and lets it go on
    helper = subprocess.Popen(
        ["sh", "-c", f"kill -STOP {os.getpid()}; sleep 0.3; kill -CONT {os.getpid()}"]
    )
    woken = [asked.wait(0.1) for _ in range(8)]
    helper.wait()
    os.kill(os.getpid(), signal.SIGTERM)
    print(woken, asked.wait(5.0))
"""


def test_being_frozen_and_continued_is_no_request_to_end() -> None:
    done = subprocess.run(
        [sys.executable, "-c", FROZEN],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
        cwd=REPOSITORY,
    )
    assert done.stdout.strip() == f"{[False] * 8} True", done.stderr
