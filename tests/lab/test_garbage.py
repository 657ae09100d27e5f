"""Nonsense against the daemon's Modbus server while a PLC works with it: seconds by default, a minute with
``--garbage-s 60``. It comes from an allowed address and from one that is not.

The daemon must not end, forget its PLC, take an order nobody gave or grow; and the PLC must be served.
"""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from drivers.types import PlcCommand
from tests.fakes.modbusnoise import TALKS, Noise
from tests.fakes.modbuswire import PollingPlc, polling
from tests.fakes.ports import free_port
from tests.fakes.simcell import sim_cell
from tests.system.processes import SPEED, Line, daemon, orders, until, write_config

SHORT_S = 4.0
SLOWEST_S = 1.4
"""The cell gives its PLC up after 1.5 s without a heartbeat."""
MOST_MEMORY_MB = 8.0
ENABLE, READY, RESULT_VALID, LINK_OK = 1, 1, 1 << 3, 1 << 12


def memory_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if "VmRSS" in line) / 1024.0


def shows(plc: PollingPlc, bit: int) -> bool:
    return bool(plc.status and plc.status[2] & bit)


def enable(plc: PollingPlc) -> None:
    until(lambda: shows(plc, LINK_OK), 30.0, "the cell hears the PLC")
    plc.command[2] = ENABLE
    until(lambda: shows(plc, READY), 10.0, "ready")


def ping(plc: PollingPlc, sequence: int) -> None:
    """One whole handshake."""
    until(lambda: shows(plc, READY), 10.0, f"ready for order {sequence}")
    plc.command[4] = int(PlcCommand.PING)
    plc.command[3] = sequence
    until(lambda: shows(plc, RESULT_VALID) and plc.status[6] == sequence, 10.0, f"result of {sequence}")
    assert plc.status[4:6] == [sequence, 0]
    assert plc.status[7] == 1
    plc.command[23] = sequence
    until(lambda: not shows(plc, RESULT_VALID), 10.0, f"result of {sequence} dropped")


def test_nonsense_changes_nothing_and_keeps_nobody_from_working(
    tmp_path: Path, pytestconfig: pytest.Config
) -> None:
    asked: float | None = pytestconfig.getoption("--garbage-s")
    lasts_s = SHORT_S if asked is None else asked
    port = free_port()
    server: Line = {
        "driver": "modbus_server",
        "bind": "127.0.0.1",
        "peers": ["127.0.0.1", "127.0.0.2"],
        "max_connections": 8,
    }
    with (
        sim_cell("--speed", SPEED, "--seed", "7", "--sticks", "1") as cell,
        daemon(write_config(tmp_path, cell.port, port, plc=server)) as running,
        polling(port, 0.02) as plc,
    ):
        running.started()
        enable(plc)
        ping(plc, 1)
        before_mb = memory_mb(running.pid)
        most_mb, sequence = before_mb, 1
        ends_at = time.monotonic() + lasts_s
        with (
            Noise(port, threads=2, seed=5, source="127.0.0.2") as allowed,
            Noise(port, threads=1, seed=6, source="127.0.0.3") as stranger,
        ):
            while time.monotonic() < ends_at:
                sequence += 1
                ping(plc, sequence)
                most_mb = max(most_mb, memory_mb(running.pid))
        after_mb = memory_mb(running.pid)
        print(
            f"\n{lasts_s:.0f} s of nonsense: {sum(allowed.talks.values())} talks, "
            f"{allowed.turned_away} cut off; {dict(allowed.talks.most_common())}; "
            f"a stranger {sum(stranger.talks.values()) + stranger.turned_away} times"
        )
        print(
            f"meanwhile {sequence - 1} orders, {plc.polls} polls, the slowest {1000 * plc.slowest_s:.0f} ms; "
            f"memory {before_mb:.1f} MB before, {most_mb:.1f} at most, {after_mb:.1f} after"
        )
        if lasts_s >= 30.0:
            assert set(allowed.talks) == {talk.__name__ for talk in TALKS}
        assert plc.errors == []
        assert plc.slowest_s < SLOWEST_S
        assert not running.events("worker_failed")
        assert [line["plc_event"] for line in running.events("plc_event")] == ["LINK_UP", "ENABLED"]
        assert [(row.seq, row.code) for row in orders(tmp_path)] == [(n, 1) for n in range(1, sequence + 1)]
        assert cell.count("motions") == 0
        named = [line["peer"] for line in running.events("plc_peer_refused")]
        assert named.count("127.0.0.3") == 1
        assert most_mb - before_mb < MOST_MEMORY_MB
        assert running.terminate()[0] == 0
