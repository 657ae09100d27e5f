"""Webcams: our own capture beside OpenCV's, from exposure to frame, and what both cost.

``python -m bench.cameras [--rates 30 15]``

Debian's kernel in a virtual machine, two emulated USB cameras at once, every picture with its number in it
(`tests/lab/vm`). The machine is emulated in software: its figures compare the two ways with each other, and
say nothing of a real machine's.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Final

from bench import machine, tables
from tests.lab.vm.machine import CannotStart
from tests.lab.vm.webcams import Webcams, plugged_in

COMMAND: Final = "python -m bench.cameras"
WAYS: Final = (("ioctl", "our own (ioctl)"), ("opencv", "OpenCV VideoCapture"))
RATES_HZ: Final = (30, 15, 5)
TASK_S: Final = 120.0


def sheet(webcams: Webcams, rates_hz: tuple[int, ...]) -> tables.Sheet:
    """Run both ways at each rate, one after the other."""
    rows = []
    for rate_hz in rates_hz:
        for capture, words in WAYS:
            task = f"{capture}:{rate_hz}"
            webcams.work(task, timeout_s=TASK_S)
            told = webcams.told(task)
            cameras = told["cameras"]
            assert isinstance(cameras, list)
            for eye, one in zip(("left", "right"), cameras, strict=True):
                rows.append(
                    (
                        words,
                        f"{rate_hz}",
                        eye,
                        f"{one['frames'] / one['span_s']:.1f}" if one["span_s"] else "-",
                        f"{1e3 * one['delay_median_s']:.0f}",
                        f"{1e3 * one['delay_p95_s']:.0f}",
                        f"{one['missing']}",
                        f"{one['dropped_since_first'] + one['incomplete_since_first']}",
                        f"{told['cpu_percent']:.0f}",
                    )
                )
    return tables.Sheet(
        title="Two webcams at once, MJPG 640x480, in a machine emulated in software",
        command=COMMAND,
        headings=(
            *("capture", "Hz set", "camera", "Hz got", "delay ms", "p95 ms"),
            *("lost", "lost, counted", "CPU % (both)"),
        ),
        rows=tuple(rows),
        notes=(
            "delay: from the exposure in the camera to decoded pixels; lost: numbers missing in the "
            "pictures; counted: what the driver says it lost (OpenCV does not know); CPU: of the two capture "
            "threads.",
            f"host: {machine.processor()}, load {machine.load()}; qemu without hardware help, cpu Nehalem.",
        ),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog=COMMAND)
    parser.add_argument("--rates", type=int, nargs="+", choices=RATES_HZ, default=[15, 5], metavar="HZ")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        try:
            with plugged_in(Path(folder)) as webcams:
                tables.show(sheet(webcams, tuple(arguments.rates)))
        except CannotStart as reason:
            raise SystemExit(f"no virtual machine: {reason}") from reason


if __name__ == "__main__":
    main()
