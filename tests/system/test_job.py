"""The whole job as the command ``mikado demo``: its processes empty a small tray, and nobody takes the
daemon's word for it."""

from __future__ import annotations

import json
import os
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.system.processes import ROOT, SPEED, Line, until

STICKS = 4


SIM = ("--driver", "sim", "--speed", SPEED)
UR = ("--driver", "ur")
POLLED = (*SIM, "--plc", "client")
"""The PLC polls the cell, which is the Modbus server."""


def _demo(out: Path, *more: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "cell", "demo", "--out", str(out), *more]
    return subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def _children(session: int) -> list[str]:
    """Command lines of the living processes of a session; read from /proc, because `ps` may not be there."""
    alive = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            # after the command's name in brackets: state, parent, group, session
            fields = (folder / "stat").read_text(encoding="utf-8", errors="replace").rsplit(")", 1)[1].split()
            if int(fields[3]) == session and fields[0] != "Z":
                alive.append((folder / "cmdline").read_text(encoding="utf-8", errors="replace"))
        except (FileNotFoundError, ProcessLookupError):
            continue  # it ended while we looked
    return alive


@pytest.mark.parametrize("driver", [SIM, UR, POLLED], ids=["sim", "ur", "sim-polled"])
def test_a_tray_is_emptied_on_the_orders_of_a_plc(tmp_path: Path, driver: tuple[str, ...]) -> None:
    out = tmp_path / "out"
    demo = _demo(out, *driver, "--sticks", str(STICKS), "--seed", "7")
    said, errors = demo.communicate(timeout=200.0)
    assert demo.returncode == 0, said + errors
    assert errors == ""

    summary: Line = json.loads((out / "summary.json").read_text())
    assert summary["good"] is True
    cell = summary["simulated_cell"]
    assert isinstance(cell, dict)
    assert (cell["in_box"], cell["in_tray"], cell["lost"]) == (STICKS, 0, 0)
    assert summary["handshake_errors"] == []
    arm = summary["simulated_controller"]
    if driver is UR:  # it was the controller's arm that moved, and its output that closed the jaws
        assert isinstance(arm, dict)
        started = arm["moves_started"]
        assert isinstance(started, int)
        assert started >= 5 * STICKS
        assert arm["safety"] == "NORMAL"
        assert arm["moving"] is False

    plc = json.loads((out / "plc.json").read_text())
    assert plc["clean"] is True
    assert plc["ended"] == "the bin is empty"
    delivered = sum(order["quantity"] for order in plc["orders"] if order["code"] == 1)
    assert delivered == STICKS

    with closing(sqlite3.connect(out / "demo.sqlite")) as journal:
        rows = journal.execute("SELECT seq, finished_at, acknowledged_at FROM orders ORDER BY id").fetchall()
    assert [row[0] for row in rows] == [order["seq"] for order in plc["orders"]]
    assert all(finished and acknowledged for _, finished, acknowledged in rows)

    overlays = sorted((out / "overlays").glob("look-*.png"))
    assert len(overlays) >= STICKS + 1  # one look each, and the one that found nothing more
    for path in overlays:
        picture = cv2.imread(str(path))
        assert picture is not None, path
        assert picture.shape[0] >= 480, path
        assert float(np.std(picture)) > 5.0, path  # not an empty canvas


@pytest.mark.parametrize("driver", [SIM, UR], ids=["sim", "ur"])
def test_a_demo_that_is_told_to_end_takes_its_processes_with_it(
    tmp_path: Path, driver: tuple[str, ...]
) -> None:
    demo = _demo(tmp_path, *driver, "--sticks", "12", "--seed", "7")
    assert demo.stdout is not None
    try:
        for line in demo.stdout:
            if "PLC orders" in line:
                break
        # itself, the cell, the PLC, the daemon; and the controller
        assert len(_children(demo.pid)) >= (4 if driver is SIM else 5)
        demo.send_signal(signal.SIGTERM)
        _, errors = demo.communicate(timeout=20.0)
        assert demo.returncode == 1
        assert errors == ""
        until(lambda: not _children(demo.pid), 1.0, "no process left")
        assert json.loads((tmp_path / "summary.json").read_text())["failed"] == "asked to end"
    finally:
        if demo.poll() is None:
            os.killpg(demo.pid, signal.SIGKILL)  # its children too: a failing test leaves nothing behind
        demo.communicate()
