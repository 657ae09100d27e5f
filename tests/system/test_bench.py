"""`make bench` runs: the README sends people there."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not on this machine")
def test_the_makefiles_bench_command_prints_both_methods() -> None:
    told = subprocess.run(["make", "-n", "bench"], cwd=ROOT, check=True, capture_output=True, text=True)
    # under `make test` this make also tells which folder it enters and leaves
    (line,) = [line for line in told.stdout.splitlines() if "bench." in line]
    _, *words = shlex.split(line)
    small = ["--piles", "1", "--sticks", "3", "--repeats", "1"]
    ran = subprocess.run(
        [sys.executable, *words, *small], cwd=ROOT, check=False, capture_output=True, text=True, timeout=120
    )
    assert ran.returncode == 0, ran.stderr
    assert "published" in ran.stdout
    assert "default" in ran.stdout
