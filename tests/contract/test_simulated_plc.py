"""The real Modbus driver and the handshake against the simulated PLC, a process of its own: whole orders, a
cell that dies in between, and cells that break the contract and must be told on.

Real time passes here because two programs run side by side; every wait ends by an event or by its limit.
"""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from cell.handshake import Memory, begin, step
from cell.types import CellReport, Outcome, PickOrder, PickResult
from drivers.errors import CommandRejected, DeviceTimeout, DeviceUnavailable
from drivers.interfaces import Plc
from drivers.plc.modbus import ModbusPlc
from drivers.plc.server import ModbusServerPlc
from drivers.plc_codec import WordOrder
from drivers.settings import ModbusPlcSettings, ModbusServerPlcSettings
from drivers.timing import MonotonicClock, StopToken
from drivers.types import PlcInputs, PlcOutputs, ResultCode
from tests.fakes.ports import free_port

ROOT = Path(__file__).parents[2]
CLOCK = MonotonicClock()


@contextlib.contextmanager
def modbus(
    port: int, word_order: WordOrder = "big", read_base: int = 0, write_base: int = 100
) -> Iterator[ModbusPlc]:
    settings = ModbusPlcSettings(
        driver="modbus",
        host="127.0.0.1",
        port=port,
        word_order=word_order,
        read_base=read_base,
        write_base=write_base,
    )
    plc = ModbusPlc("plc", settings, CLOCK)
    plc.open()
    try:
        yield plc
    finally:
        plc.close()


class SimulatedPlc:
    """The process ``drivers.sim.plc``."""

    def __init__(self, out: Path, *arguments: str) -> None:
        self.out = out
        self.process = subprocess.Popen(
            [sys.executable, "-W", "error", "-m", "drivers.sim.plc", "--out", str(out), *arguments],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        first = json.loads(self.process.stdout.readline())
        assert first["event"] == ("polling" if "--connect" in arguments else "listening")
        self.port = int(first["port"])

    def ended(self) -> bool:
        return self.process.poll() is not None

    def result(self, within_s: float = 10.0) -> tuple[int, list[str], dict[str, object]]:
        """Exit code, names of the events printed, summary."""
        stdout, stderr = self.process.communicate(timeout=within_s)
        assert stderr == ""
        names = [str(json.loads(line)["event"]) for line in stdout.splitlines()]
        summary: dict[str, object] = json.loads(self.out.read_text())
        return self.process.returncode, names, summary

    def close(self) -> None:
        if not self.ended():
            self.process.kill()
        self.process.communicate(timeout=5.0)


@pytest.fixture
def simulated(tmp_path: Path) -> Iterator[Callable[..., SimulatedPlc]]:
    started: list[SimulatedPlc] = []

    def start(*arguments: str) -> SimulatedPlc:
        started.append(SimulatedPlc(tmp_path / "summary.json", *arguments))
        return started[-1]

    yield start
    for plc in started:
        plc.close()


class SmallCell:
    """The handshake over the real driver, with work that is done after ``polls_of_work`` polls."""

    def __init__(self, plc: Plc, memory: Memory | None = None, polls_of_work: int = 4) -> None:
        self._plc = plc
        self._stop = StopToken(CLOCK)
        self.memory = memory or begin(boot_id=1, accepted=0, finished=None)
        self.outputs = PlcOutputs()
        self.orders: list[PickOrder] = []
        self.polls_of_work = polls_of_work
        self._left = 0
        self.code = ResultCode.OK
        self.detail = 0
        self.tamper: Callable[[PlcOutputs], PlcOutputs] = lambda outputs: outputs
        self._step(None, None)

    def _step(self, inputs: PlcInputs | None, finished: PickResult | None) -> None:
        working = bool(self.memory.in_flight) and finished is None
        report = CellReport(state=6 if working else 4, accepting=not working, busy=working)
        got = step(self.memory, inputs, report, finished, CLOCK.now())
        self.memory, self.outputs = got.memory, got.outputs
        if got.order is not None:
            self.orders.append(got.order)
            self._left = self.polls_of_work

    def poll(self) -> None:
        inputs = None
        with contextlib.suppress(DeviceUnavailable, DeviceTimeout):
            inputs = self._plc.exchange(self.tamper(self.outputs))
        finished = None
        if self.memory.in_flight:
            self._left -= 1
            if self._left == 0:
                finished = PickResult(
                    request_id=self.memory.in_flight,
                    code=self.code,
                    outcome=Outcome.PICKED,
                    detail=self.detail,
                    quantity=1,
                    confidence=0.9,
                    took_s=0.1,
                )
        self._step(inputs, finished)
        self._stop.wait(0.01)

    def run_until(self, condition: Callable[[], bool], within_s: float = 15.0) -> None:
        ends_at = CLOCK.now() + within_s
        while not condition():
            assert CLOCK.now() < ends_at, f"not within {within_s} s"
            self.poll()


@pytest.mark.parametrize("extra", [(), ("--crc",), ("--word-order", "little")])
def test_orders_are_taken_finished_acknowledged_and_closed_over_the_wire(
    simulated: Callable[..., SimulatedPlc], extra: tuple[str, ...]
) -> None:
    peer = simulated("--orders", "3", "--part", "8", "--command", "1", "--speed-percent", "25", *extra)
    with modbus(peer.port, word_order="little" if "little" in extra else "big") as plc:
        cell = SmallCell(plc)
        cell.run_until(peer.ended)
    code, events, summary = peer.result()
    assert summary["handshake_errors"] == []
    assert code == 0
    assert [o.request_id for o in cell.orders] == [1, 2, 3]
    assert {(o.part_code, int(o.command), o.speed_fraction) for o in cell.orders} == {(8, 1, 0.25)}
    assert events == ["cell_back", *["ordered", "accepted", "result", "closed"] * 3, "ended"]
    assert summary["results_by_code"] == {"1": 3}


@contextlib.contextmanager
def serving(port: int, word_order: WordOrder = "big") -> Iterator[ModbusServerPlc]:
    settings = ModbusServerPlcSettings(
        driver="modbus_server", bind="127.0.0.1", port=port, peers=("127.0.0.1",), word_order=word_order
    )
    plc = ModbusServerPlc("plc", settings, CLOCK)
    plc.open()
    try:
        yield plc
    finally:
        plc.close()


@pytest.mark.parametrize("extra", [(), ("--crc",), ("--word-order", "little")])
def test_a_plc_that_polls_the_cell_gets_the_same_orders_done(
    simulated: Callable[..., SimulatedPlc], extra: tuple[str, ...]
) -> None:
    port = free_port()
    peer = simulated("--connect", f"127.0.0.1:{port}", "--orders", "3", "--part", "8", *extra)
    with serving(port, "little" if "little" in extra else "big") as plc:
        cell = SmallCell(plc)
        cell.run_until(peer.ended)
    code, events, summary = peer.result()
    assert summary["handshake_errors"] == []
    assert code == 0
    assert [(o.request_id, o.part_code) for o in cell.orders] == [(1, 8), (2, 8), (3, 8)]
    assert events == ["cell_back", *["ordered", "accepted", "result", "closed"] * 3, "ended"]


def test_a_plc_that_polls_a_cell_that_dies_gets_42_and_goes_on(
    simulated: Callable[..., SimulatedPlc],
) -> None:
    port = free_port()
    peer = simulated("--connect", f"127.0.0.1:{port}", "--orders", "3")
    with serving(port) as plc:
        cell = SmallCell(plc, polls_of_work=10**6)
        cell.run_until(lambda: len(cell.orders) == 1)
        cell.poll()
        accepted = cell.memory.accepted
    interrupted = PickResult(
        request_id=accepted, code=ResultCode.INTERRUPTED_BY_RESTART, outcome=Outcome.ABORTED
    )
    with serving(port) as plc:
        cell = SmallCell(plc, begin(boot_id=2, accepted=accepted, finished=interrupted))
        cell.run_until(peer.ended)
    code, _, summary = peer.result()
    assert (code, summary["handshake_errors"], summary["cell_restarts"]) == (0, [], 1)
    assert summary["results_by_code"] == {"1": 2, "42": 1}
    assert [o.request_id for o in cell.orders] == [2, 3]


def test_until_empty_ends_when_the_bin_is_reported_empty(simulated: Callable[..., SimulatedPlc]) -> None:
    peer = simulated("--orders", "until-empty")
    with modbus(peer.port) as plc:
        cell = SmallCell(plc)
        cell.run_until(lambda: len(cell.orders) == 2)
        cell.code, cell.detail = ResultCode.NO_PART_FOUND, 2
        cell.run_until(peer.ended)
    code, _, summary = peer.result()
    assert (code, summary["ended"]) == (0, "the bin is empty")
    assert summary["results_by_code"] == {"1": 1, "10": 1}


def test_a_cell_that_dies_with_an_order_in_flight_ends_it_with_42_and_goes_on(
    simulated: Callable[..., SimulatedPlc],
) -> None:
    peer = simulated("--orders", "3")
    with modbus(peer.port) as plc:
        cell = SmallCell(plc, polls_of_work=10**6)
        cell.run_until(lambda: len(cell.orders) == 1)
        cell.poll()
        accepted = cell.memory.accepted
    interrupted = PickResult(
        request_id=accepted, code=ResultCode.INTERRUPTED_BY_RESTART, outcome=Outcome.ABORTED
    )
    with modbus(peer.port) as plc:
        cell = SmallCell(plc, begin(boot_id=2, accepted=accepted, finished=interrupted))
        cell.run_until(peer.ended)
    code, _, summary = peer.result()
    assert summary["handshake_errors"] == []
    assert (code, summary["cell_restarts"]) == (0, 1)
    assert summary["results_by_code"] == {"1": 2, "42": 1}
    assert [o.request_id for o in cell.orders] == [2, 3]


def test_a_refused_order_is_recorded_and_the_next_number_follows(
    simulated: Callable[..., SimulatedPlc],
) -> None:
    peer = simulated("--orders", "2", "--command", "5")
    with modbus(peer.port) as plc:
        cell = SmallCell(plc)
        cell.run_until(peer.ended)
    code, events, summary = peer.result()
    assert (code, cell.orders) == (0, [])
    assert summary["results_by_code"] == {"50": 2}
    assert events.count("refused") == 2


@pytest.mark.parametrize(
    ("tamper", "complaint"),
    [
        (lambda o: replace(o, result_seq=o.result_seq + 1) if o.result_valid else o, "while 1 was ordered"),
        (lambda o: replace(o, result_valid=o.busy), "before it was accepted|without a code|while"),
        (lambda o: replace(o, busy=False), "accepted, but the cell is not busy"),
        (lambda o: replace(o, result_code=0), "valid without a code"),
        (lambda o: replace(o, ready=True), "ready together with busy"),
        (lambda o: replace(o, map_version=2), "map version 2"),
        (
            lambda o: replace(o, accepted_seq=9) if o.accepted_seq else o,
            "answered 9, which was never ordered",
        ),
    ],
)
def test_a_cell_that_breaks_a_rule_is_told_on(
    simulated: Callable[..., SimulatedPlc], tamper: Callable[[PlcOutputs], PlcOutputs], complaint: str
) -> None:
    peer = simulated("--orders", "1", "--deadline-s", "2")
    with modbus(peer.port) as plc:
        cell = SmallCell(plc)
        cell.tamper = tamper
        cell.run_until(peer.ended)
    code, events, summary = peer.result()
    errors = summary["handshake_errors"]
    assert isinstance(errors, list)
    assert code == 1
    assert "violation" in events
    assert any(part in str(error) for error in errors for part in complaint.split("|"))


def test_a_cell_whose_heartbeat_stands_while_it_is_connected_is_told_on(
    simulated: Callable[..., SimulatedPlc],
) -> None:
    peer = simulated("--orders", "1")
    with modbus(peer.port) as plc:
        cell = SmallCell(plc)
        cell.run_until(lambda: cell.memory.enabled)
        standing, ends_at = cell.outputs, CLOCK.now() + 1.8
        while CLOCK.now() < ends_at:
            plc.exchange(standing)
        cell.run_until(peer.ended)
    code, _, summary = peer.result()
    assert code == 1
    assert "stood for" in str(summary["handshake_errors"])


def test_sigterm_ends_the_simulated_plc_quickly_and_leaves_a_summary(
    simulated: Callable[..., SimulatedPlc],
) -> None:
    peer = simulated("--orders", "5")
    peer.process.send_signal(signal.SIGTERM)
    code, events, summary = peer.result(within_s=2.0)
    assert (code, summary["ended"], events) == (0, "asked to end", ["ended"])


def test_the_cell_may_write_the_status_block_only(simulated: Callable[..., SimulatedPlc]) -> None:
    peer = simulated("--orders", "1")
    wrong = "write of 40 registers at 0 refused: exception 2"
    with modbus(peer.port, read_base=100, write_base=0) as plc, pytest.raises(CommandRejected, match=wrong):
        plc.exchange(PlcOutputs())
