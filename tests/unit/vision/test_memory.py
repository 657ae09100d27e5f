"""Freed memory stays with the process; tried in one of its own, since it is a setting of a whole process."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import resource, sys
import numpy as np
from vision.memory import keep_freed

def faults():
    began = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        held = [np.empty(1_500_000, np.uint8) for _ in range(20)]
        for one in held:
            one[::4096] = 1
        del held, one
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - began

before = faults()
known = keep_freed()
faults()
print(int(known), before, faults())
"""


def test_what_was_freed_is_not_paged_in_again() -> None:
    told = subprocess.run(
        [sys.executable, "-c", PROGRAM], check=True, capture_output=True, text=True, timeout=60
    )
    known, before, after = (int(word) for word in told.stdout.split())

    assert known == 1
    # 20 times 30 MB in pages of 4 KiB are 146,000
    assert before > 50_000
    assert after < before / 50
