"""What the service manager hears: ready once it is true, the watchdog only while every worker makes
progress, and the end."""

from __future__ import annotations

import itertools
import signal
import time
from pathlib import Path

import pytest

from drivers.types import ResultCode
from tests.fakes.simcell import SimCell
from tests.system.handplc import HandPlc
from tests.system.processes import daemon, notify_socket, write_config

HANG = Path(__file__).parent / "hanging_daemon.py"


def test_it_is_told_when_the_daemon_is_ready_alive_frozen_and_ending(
    tmp_path: Path, cell: SimCell, plc: HandPlc
) -> None:
    config = write_config(tmp_path, cell.port, plc.port)
    with notify_socket(tmp_path / "notify") as manager, daemon(config, notify=manager.path) as running:
        first = manager.listen(30.0, end="READY=1")
        assert "WATCHDOG=1" not in first
        running.started()
        plc.enable()

        told = manager.listen(2.0)
        assert 3 <= told.count("WATCHDOG=1") <= 6
        times = [at for at, text in manager.messages if "WATCHDOG=1" in text]
        assert max(b - a for a, b in itertools.pairwise(times)) < 2.0
        assert any(text.startswith("STATUS=idle, 0 picked") for text in told)

        # a pick takes longer than a beat and must not starve it
        assert plc.run().result_code == ResultCode.OK
        assert "WATCHDOG=1" in manager.drain()

        running.signal(signal.SIGSTOP)
        manager.drain()
        assert manager.listen(1.5) == []
        running.signal(signal.SIGCONT)
        manager.listen(3.0, end="WATCHDOG=1")

        running.signal(signal.SIGTERM)
        manager.listen(5.0, end="STOPPING=1")
        assert running.process.wait(5.0) == 0


@pytest.mark.parametrize("worker", ["cell", "plc"])
def test_a_worker_that_hangs_starves_the_watchdog_though_the_main_thread_lives(
    tmp_path: Path, cell: SimCell, plc: HandPlc, worker: str
) -> None:
    """The worker hangs in a call that neither waits on its token nor comes back, as a library may."""
    with notify_socket(tmp_path / "notify") as manager:
        config = write_config(tmp_path, cell.port, plc.port)
        hang = tmp_path / "hang"
        command = [str(HANG), worker, str(hang), str(config)]
        with daemon(config, notify=manager.path, command=command) as running:
            running.started()
            plc.enable()
            manager.listen(3.0, end="WATCHDOG=1")
            hang.touch()
            if worker == "cell":
                plc.order()
            running.wait_for("worker_stalled", 10.0, worker=worker)
            manager.drain()
            # the main thread is there, has said once who hangs, and does not feed
            assert "WATCHDOG=1" not in manager.listen(1.5)
            assert len(running.events("worker_stalled")) == 1

            # the PLC sees a hung cell thread as an order that lasts, and a hung PLC thread as silence
            beat = plc.status.heartbeat
            time.sleep(1.0)
            assert (plc.status.heartbeat == beat) == (worker == "plc")

            # asked to end, it names the one that does not, and ends all the same
            code, _ = running.terminate(6.0)
            assert code == 1
            running.wait_for("worker_did_not_end", 1.0)
