"""A cell and a PLC in dialogue, poll by poll, for the tests of the handshake."""

from __future__ import annotations

from dataclasses import replace

from cell.handshake import Memory, PlcEvent, Step, begin, step
from cell.types import CellReport, Outcome, PickOrder, PickResult
from drivers.types import PlcInputs, PlcOutputs, ResultCode, ToolPose
from tests.fakes.plc import IDLE

POLL_S = 0.05
READY = CellReport(state=4, accepting=True)
WORKING = CellReport(state=6, busy=True)


def result(sequence: int, code: ResultCode = ResultCode.OK) -> PickResult:
    return PickResult(
        request_id=sequence,
        code=code,
        outcome=Outcome.PICKED,
        detail=3,
        quantity=1,
        part_type=7,
        confidence=0.5,
        pose=ToolPose(x=0.1, y=0.2, z=0.3, rx=0.0, ry=0.0, rz=0.0),
        took_s=2.5,
    )


class Dialogue:
    """A cell and a PLC that is looked at every 50 ms; the PLC's heartbeat counts at every poll."""

    def __init__(self, memory: Memory | None = None) -> None:
        self.memory = memory or begin(boot_id=77, accepted=0, finished=None)
        self.now = 100.0
        self.plc = replace(IDLE, heartbeat=10)
        self.report = READY
        self.plc_alive = True
        self.orders: list[PickOrder] = []
        self.events: list[PlcEvent] = []
        self.out: PlcOutputs = self.poll(lost=True).outputs

    def poll(
        self, *, lost: bool = False, finished: PickResult | None = None, after_s: float = POLL_S
    ) -> Step:
        self.now += after_s
        inputs: PlcInputs | None = None
        if not lost:
            beat = (self.plc.heartbeat + self.plc_alive) % 65536
            self.plc = replace(self.plc, heartbeat=beat, read_at=self.now)
            inputs = self.plc
        got = step(self.memory, inputs, self.report, finished, self.now)
        self.memory, self.out = got.memory, got.outputs
        self.events += got.events
        self.orders += [got.order] if got.order else []
        return got

    def polls(self, n: int) -> Step:
        for _ in range(n - 1):
            self.poll()
        return self.poll()

    def valid(self) -> bool:
        return self.out.result_valid

    def ready(self) -> bool:
        return self.out.ready

    def linked(self) -> bool:
        return self.out.plc_link_ok

    def show(self, sequence: int, **changes: object) -> None:
        self.plc = replace(self.plc, cmd_seq=sequence, **changes)  # type: ignore[arg-type]  # by name

    def finish(self, sequence: int, code: ResultCode = ResultCode.OK) -> None:
        """Publish completely: three polls until valid."""
        self.report = READY
        self.poll(finished=result(sequence, code))
        self.polls(2)
