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
def test_the_makefiles_bench_command_measures_everything_and_writes_the_page(tmp_path: Path) -> None:
    told = subprocess.run(["make", "-n", "bench"], cwd=ROOT, check=True, capture_output=True, text=True)
    # under `make test` this make also tells which folder it enters and leaves
    (line,) = [line for line in told.stdout.splitlines() if "-m bench." in line]
    _, *words = shlex.split(line)
    page = tmp_path / "page.md"
    small = ["--effort", "small", "--seed", "5", "--out", str(page)]
    ran = subprocess.run(
        [sys.executable, *words, *small], cwd=ROOT, check=False, capture_output=True, text=True, timeout=240
    )
    assert ran.returncode == 0, ran.stderr
    assert max(len(row) for row in ran.stdout.splitlines()) <= 120
    written = page.read_text(encoding="utf-8")
    for section in (
        *(
            "Fresh scenes of our own renderer",
            "Several products in one heap",
            "Robustness",
            "Table 1 of the paper again",
        ),
        *("Thinning and skeleton graphs", "Speed on one core", "Stages", "First look after a start"),
    ):
        assert f"## {section}" in written
        assert section in ran.stdout
    assert "Not run: photorealistic scenes" in written
    assert "| seed | 5 |" in written
    # a method that finds nothing of three sticks lying apart is broken, or the bench is
    (ours,) = [row for row in written.splitlines() if row.startswith("| A (1) | default |")]
    assert int(ours.split("|")[3]) >= 50
