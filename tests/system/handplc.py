"""A PLC on the wire that the test moves by hand; every rule of the handshake is checked meanwhile."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from drivers.plc_map import next_sequence
from drivers.sim.plc import RegisterServer
from drivers.sim.plc_program import PlcProgram, Task
from drivers.timing import MonotonicClock
from drivers.types import PlcCommand, PlcInputs, PlcOutputs, ResultCode
from tests.system.processes import POLL_S, until

CLOCK = MonotonicClock()


class _HandProgram(PlcProgram):
    """No step chain: it counts its heartbeat, and everything else is the test's."""

    def __init__(self) -> None:
        super().__init__(Task(orders=None))
        self.lock = threading.Lock()
        self.writes: list[PlcOutputs] = []
        self.before_write: Callable[[PlcOutputs], bool] = lambda status: True
        self.standing = False

    def scan(self, now: float) -> None:
        if self.standing:
            return
        with self.lock:
            self.command = replace(self.command, heartbeat=(self.command.heartbeat + 1) & 0xFFFF)

    def cell_wrote(self, status: PlcOutputs, now: float) -> None:
        with self.lock:
            if not self.before_write(status):
                return
            self.writes.append(status)
            super().cell_wrote(status, now)


@dataclass(slots=True)
class HandPlc:
    """A Modbus TCP server with map v1 whose command block the test writes; every rule is checked."""

    port: int
    program: _HandProgram
    sequence: int = 0

    @property
    def status(self) -> PlcOutputs:
        with self.program.lock:
            return self.program.rules.status

    @property
    def violations(self) -> list[str]:
        with self.program.lock:
            return list(self.program.violations)

    def change(self, **fields: bool | int) -> None:
        """Write fields of the command block, all in one scan."""
        with self.program.lock:
            self.program.command = _changed(self.program.command, fields)

    def wait(self, condition: Callable[[PlcOutputs], bool], what: str, within_s: float = 15.0) -> PlcOutputs:
        """Wait until the cell's last written status is so."""
        ends_at = time.monotonic() + within_s
        while not condition(self.status):
            assert time.monotonic() < ends_at, (
                f"not within {within_s:g} s: {what}; the cell shows {self.status}"
            )
            time.sleep(POLL_S)
        return self.status

    @contextmanager
    def standing(self) -> Iterator[None]:
        """The program stands while the server still answers."""
        self.program.standing = True
        try:
            yield
        finally:
            self.program.standing = False

    def enable(self) -> None:
        """Low and high again, as after every loss of the link; returns when the cell is ready."""
        self.change(enable=False)
        seen = len(self.program.writes)
        until(lambda: len(self.program.writes) > seen + 1, 30.0, "the cell reads that enable is low")
        self.wait(lambda s: s.plc_link_ok and not s.ready, "link up while disabled")
        self.change(enable=True)
        self.wait(lambda s: s.ready, "ready")

    def reset(self) -> None:
        """A rising edge of the reset bit, each level long enough to be read."""
        for level in (False, True):
            self.change(reset_fault=level)
            seen = len(self.program.writes)
            until(lambda seen=seen: len(self.program.writes) > seen + 1, 10.0, "the cell reads the reset bit")  # type: ignore[misc]

    def order(self, command: PlcCommand = PlcCommand.PICK_AND_PLACE, attempts: int = 3) -> int:
        """Payload first, then the next sequence number; does not wait."""
        self.sequence = next_sequence(self.sequence)
        self.change(cmd_code=int(command), max_attempts=attempts)
        with self.program.lock:
            self.program.rules.ordered(self.sequence)
        self.change(cmd_seq=self.sequence)
        return self.sequence

    def result(self, sequence: int, within_s: float = 20.0) -> PlcOutputs:
        """Wait for the result of this order, take it and see it dropped."""

        def answered(status: PlcOutputs) -> bool:
            refused = status.accepted_seq == sequence and status.ack_code != 0
            assert not refused, f"order {sequence} was refused with {status.ack_code}"
            return status.result_valid and status.result_seq == sequence

        got = self.wait(answered, f"result of {sequence}", within_s)
        with self.program.lock:
            self.program.rules.acknowledged(sequence)
        self.change(result_ack_seq=sequence)
        self.wait(lambda s: not s.result_valid, f"result of {sequence} dropped")
        with self.program.lock:
            self.program.rules.closed()
        return got

    def run(self, command: PlcCommand = PlcCommand.PICK_AND_PLACE, attempts: int = 3) -> PlcOutputs:
        """One whole order."""
        return self.result(self.order(command, attempts))

    def empty(self, most_orders: int) -> list[ResultCode]:
        """Order picks until the cell reports an empty bin; the codes of all results."""
        codes = []
        for _ in range(most_orders):
            self.wait(lambda s: s.ready, "ready")
            got = self.run()
            codes.append(ResultCode(got.result_code))
            if got.result_code == ResultCode.NO_PART_FOUND and got.result_detail == 2:
                return codes
        raise AssertionError(f"not empty after {most_orders} orders: {codes}")


def _changed(command: PlcInputs, fields: dict[str, bool | int]) -> PlcInputs:
    return replace(command, **fields)  # type: ignore[arg-type]  # names of its fields


@contextmanager
def hand_plc(port: int = 0) -> Iterator[HandPlc]:
    """A PLC in a thread of the test; it has stopped listening when the context ends."""
    program = _HandProgram()
    server = RegisterServer(program, CLOCK, host="127.0.0.1", port=port)
    listening = threading.Event()
    ended = threading.Event()
    taken: list[int] = []

    async def serve() -> None:
        taken.append(await server.listen())
        listening.set()
        while not ended.is_set():
            program.scan(CLOCK.now())
            await asyncio.sleep(0.02)
        await server.close()

    thread = threading.Thread(target=lambda: asyncio.run(serve()), name="hand-plc")
    thread.start()
    try:
        assert listening.wait(10.0), "the PLC of the test does not listen"
        yield HandPlc(port=taken[0], program=program)
    finally:
        ended.set()
        thread.join(10.0)
