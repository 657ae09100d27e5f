"""The simulated PLC's program when picking comes to nothing: it ends instead of ordering for ever."""

from __future__ import annotations

from dataclasses import replace

from drivers.sim.plc_program import MOST_FRUITLESS, PlcProgram, Task
from drivers.types import PlcOutputs, ResultCode

EMPTY, NOTHING_GRASPABLE = 2, 3


class Answering:
    """A cell that answers every order in time, with results from a list; the last one for ever."""

    def __init__(self, task: Task, results: list[tuple[ResultCode, int, int]]) -> None:
        self.program = PlcProgram(task)
        self._results = results
        self._status = PlcOutputs(plc_link_ok=True, boot_id=1)
        self._now = 0.0
        self.program.scan(self._now)

    def run(self, limit: int) -> str | None:
        """Scan until the program ends; why it did."""
        for _ in range(limit):
            self._now += 0.05
            self._answer()
            self._status = replace(self._status, heartbeat=(self._status.heartbeat + 1) & 0xFFFF)
            self.program.cell_wrote(self._status, self._now)
            self.program.scan(self._now)
            if self.program.ended is not None:
                return self.program.ended
        return None

    def _answer(self) -> None:
        shown = self.program.command
        if shown.cmd_seq and shown.cmd_seq != self._status.accepted_seq:
            self._status = replace(self._status, accepted_seq=shown.cmd_seq, ready=False, busy=True)
        elif self._status.busy:
            code, detail, quantity = self._results.pop(0) if len(self._results) > 1 else self._results[0]
            self._status = replace(
                self._status,
                busy=False,
                result_seq=shown.cmd_seq,
                result_code=int(code),
                result_detail=detail,
                quantity=quantity,
                result_valid=True,
            )
        elif self._status.result_valid and shown.result_ack_seq == self._status.result_seq:
            self._status = replace(self._status, result_valid=False)
        elif not self._status.result_valid:
            self._status = replace(self._status, ready=shown.enable)


PICKED = (ResultCode.OK, 1, 1)
NOTHING = (ResultCode.NO_PART_FOUND, NOTHING_GRASPABLE, 0)


def test_a_cell_that_brings_nothing_again_and_again_is_given_up() -> None:
    cell = Answering(Task(orders=None), [NOTHING, PICKED, NOTHING])
    assert cell.run(2000) == f"{MOST_FRUITLESS} orders in a row brought nothing"
    # one in vain, one picked, and then ten in vain
    assert [order.quantity for order in cell.program.orders] == [0, 1] + [0] * MOST_FRUITLESS
    assert cell.program.violations == []
    assert cell.program.clean


def test_an_empty_bin_ends_the_program_at_once() -> None:
    cell = Answering(Task(orders=None), [PICKED, (ResultCode.NO_PART_FOUND, EMPTY, 0)])
    assert cell.run(2000) == "the bin is empty"
    assert len(cell.program.orders) == 2


def test_a_number_of_orders_is_carried_out_whatever_they_bring() -> None:
    cell = Answering(Task(orders=MOST_FRUITLESS + 3), [NOTHING])
    assert cell.run(4000) == "all orders done"
    assert len(cell.program.orders) == MOST_FRUITLESS + 3
