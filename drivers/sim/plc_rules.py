"""What a PLC may expect of the cell (map v1), checked at every write of the status block.

The checker is told what the PLC program does (ordered, acknowledged, closed) and sees every write the cell
makes, in order; it answers with sentences about broken rules. Pure: the caller brings the time.
"""

from __future__ import annotations

from collections.abc import Iterable

from drivers.plc_map import MAP_VERSION
from drivers.types import PlcOutputs

HEARTBEAT_STANDS_S = 1.5


class ContractCheck:
    """The rules of the handshake as seen from the PLC, for one PLC program's life."""

    def __init__(self) -> None:
        self.status = PlcOutputs(map_version=0)
        self.restarts = 0
        self.longest_beat_s = 0.0
        self._met = False
        self._known: set[int] = {0}
        self._ordered = 0
        self._accepted_by: int | None = None
        self._acknowledged = 0
        self._closed: set[int] = set()
        self._published = (0, -1)
        self._beat_at: float | None = None
        self._line = 0
        self._beat_line = 0

    def ordered(self, sequence: int) -> None:
        """The program has written this sequence number."""
        self._ordered, self._accepted_by = sequence, None
        self._known.add(sequence)
        self._closed.discard(sequence)

    def remembered(self, sequences: Iterable[int]) -> None:
        """A program before this one has written these: a cell may come back to them."""
        self._known.update(sequences)

    def acknowledged(self, sequence: int) -> None:
        """The program has written this result acknowledgement."""
        self._acknowledged = sequence

    def closed(self) -> None:
        """The order is over: its result is taken and dropped, or it was refused."""
        self._closed.add(self._ordered)
        self._ordered, self._accepted_by = 0, None

    def connected(self) -> None:
        """A cell has connected: heartbeats do not count across this."""
        self._line += 1

    def alive(self, now: float) -> bool:
        """The cell's heartbeat has counted lately."""
        return self._beat_at is not None and now - self._beat_at <= HEARTBEAT_STANDS_S

    def wrote(self, status: PlcOutputs, now: float) -> list[str]:
        """One write of the cell; what is wrong with it."""
        before, self.status = self.status, status
        if not self._met:
            self._met = True
            before = PlcOutputs(boot_id=status.boot_id, heartbeat=status.heartbeat)
            self._known.add(status.accepted_seq)
            self._beat_at, self._beat_line = now, self._line
        restarted = status.boot_id != before.boot_id
        if restarted:
            self.restarts += 1
        broken = self._beat(before, status, restarted, now)
        broken += self._levels(status)
        broken += self._answer(status)
        broken += self._result(before, status, restarted)
        return broken

    def _beat(self, before: PlcOutputs, status: PlcOutputs, restarted: bool, now: float) -> list[str]:
        if status.heartbeat == before.heartbeat and not restarted:
            return []
        stood_s = now - (now if self._beat_at is None else self._beat_at)
        same_line = self._beat_line == self._line and not restarted
        self._beat_at, self._beat_line = now, self._line
        if not same_line:
            return []
        self.longest_beat_s = max(self.longest_beat_s, stood_s)
        if stood_s > HEARTBEAT_STANDS_S:
            return [f"the cell's heartbeat stood for {stood_s:.2f} s while it was connected"]
        return []

    def _levels(self, status: PlcOutputs) -> list[str]:
        broken = []
        if status.map_version != MAP_VERSION:
            broken.append(f"map version {status.map_version} instead of {MAP_VERSION}")
        for other, name in (
            (status.busy, "busy"),
            (status.result_valid, "result valid"),
            (status.fault, "fault"),
        ):
            if status.ready and other:
                broken.append(f"ready together with {name}")
        return broken

    def _answer(self, status: PlcOutputs) -> list[str]:
        broken = []
        if status.accepted_seq not in self._known:
            broken.append(f"answered {status.accepted_seq}, which was never ordered")
        if self._ordered and status.accepted_seq == self._ordered and status.ack_code == 0:
            if self._accepted_by is None:
                self._accepted_by = status.boot_id
            shown = status.result_valid and status.result_seq == self._ordered
            taken = self._acknowledged == self._ordered
            if self._accepted_by == status.boot_id and not (status.busy or shown or taken):
                broken.append(f"order {self._ordered} was accepted, but the cell is not busy")
        return broken

    def _result(self, before: PlcOutputs, status: PlcOutputs, restarted: bool) -> list[str]:
        sequence = status.result_seq
        if before.result_valid and not status.result_valid and not restarted:
            if self._acknowledged != before.result_seq:
                return [f"result of {before.result_seq} taken back before it was acknowledged"]
            return []
        if not status.result_valid:
            return []
        if before.result_valid and not restarted:
            if _payload(before) != _payload(status):
                return [f"result of {sequence} changed while it was valid"]
            return []
        broken = []
        # a cell that has restarted may not know that its result was taken, and shows it once more
        again = self._published[0] == sequence and self._published[1] != status.boot_id
        self._published = (sequence, status.boot_id)
        if sequence in self._closed:
            if not again:
                broken.append(f"a second result of {sequence}")
        elif sequence != self._ordered and (self._ordered or self._closed):
            broken.append(f"a result of {sequence} while {self._ordered or 'nothing'} was ordered")
        elif self._ordered and self._accepted_by is None:
            broken.append(f"a result of {sequence} before it was accepted")
        if status.result_code == 0:
            broken.append(f"result of {sequence} is valid without a code")
        return broken


def _payload(status: PlcOutputs) -> tuple[object, ...]:
    return (
        status.result_seq,
        status.result_code,
        status.result_detail,
        status.quantity,
        status.part_type,
        status.confidence,
        status.pose,
        status.cycle_time_s,
    )
