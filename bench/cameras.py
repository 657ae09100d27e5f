"""Cameras: our own drivers beside OpenCV, Aravis alone and viva-genicam, from exposure to frame; their cost.

``python -m bench.cameras [--rates 30 15] [--only webcams|gige]``; GigE Vision (`bench.gige`) as root.

Webcams: Debian's kernel in a virtual machine, two emulated USB cameras at once, every picture with its number
in it (`tests/lab/vm`). The machine is emulated in software: its figures compare the two ways with each other,
and say nothing of a real machine's.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Final

from bench import gige, machine, tables
from tests.lab.vm.machine import CannotStart
from tests.lab.vm.webcams import Webcams, plugged_in

COMMAND: Final = "python -m bench.cameras"
WAYS: Final = (("ioctl", "our own (ioctl)"), ("opencv", "OpenCV VideoCapture"))
RATES_HZ: Final = (30, 15, 5)
TASK_S: Final = 120.0
GIGE_S, GIGE_PAIRS = 10.0, 100
"""For each way and rate; pairs for each kind of trigger."""


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
                        _skew(told["skew_s"]),
                    )
                )
    return tables.Sheet(
        title="Two webcams at once, MJPG 640x480, in a machine emulated in software",
        command=COMMAND,
        headings=(
            *("capture", "Hz set", "camera", "Hz got", "delay ms", "p95 ms"),
            *("lost", "lost, counted", "CPU % (both)", "skew ms"),
        ),
        rows=tuple(rows),
        notes=(
            "delay: from the exposure in the camera to decoded pixels; lost: numbers missing in the "
            "pictures; counted: what the driver says it lost (OpenCV does not know); CPU: of the two capture "
            "threads; skew: of each left picture to the nearest right one, median/p95/most.",
            f"host: {machine.processor()}, load {machine.load()}; qemu without hardware help, cpu Nehalem.",
        ),
    )


def _skew(told: object) -> str:
    assert isinstance(told, list)
    return "/".join(f"{1e3 * one:.0f}" for one in told) or "-"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog=COMMAND)
    parser.add_argument("--rates", type=int, nargs="+", choices=RATES_HZ, default=[15, 5], metavar="HZ")
    parser.add_argument("--only", choices=("webcams", "gige"), help="one part (usual: both)")
    arguments = parser.parse_args()
    rates_hz = tuple(arguments.rates)
    if arguments.only != "webcams":
        _gige(rates_hz)
    if arguments.only != "gige":
        _webcams(rates_hz)


def _gige(rates_hz: tuple[int, ...]) -> None:
    try:
        for one in gige.sheets(rates_hz, GIGE_S, GIGE_PAIRS):
            tables.show(one)
    except gige.NoCameras as reason:
        sys.stderr.write(f"no GigE Vision cameras: {reason}\n")


def _webcams(rates_hz: tuple[int, ...]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        try:
            with plugged_in(Path(folder)) as webcams:
                tables.show(sheet(webcams, rates_hz))
        except CannotStart as reason:
            raise SystemExit(f"no virtual machine: {reason}") from reason


if __name__ == "__main__":
    main()
