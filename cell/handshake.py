"""The PLC handshake (register map v1) as one pure step: what the PLC shows goes in, what we show comes out.

The caller polls: exchange, `step`, wait, again. It hands in what the exchange read (None when it failed)
and, once, each result the cell has come to. It gets back what to send in the next exchange and, at most
once per sequence number, an order.

Three rules make broken polls harmless. An order counts when its check word fits, or when two successive
good polls show the same order. A result goes out in three exchanges, payload, then its sequence number,
then "valid", each only after the one before was really sent. And whatever has been answered, accepted or
refused, keeps its answer while the PLC goes on showing it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from cell.choices import Choice
from cell.handshake_memory import MAP_VERSION, Memory, PlcEvent, Publication, outputs_of
from cell.modes import REFUSED, Mode
from cell.types import CellReport, PickOrder, PickResult
from drivers.types import PlcCommand, PlcInputs, PlcOutputs, ResultCode

__all__ = ["Memory", "PlcEvent", "Publication", "Step", "begin", "step", "withdraw"]

BEAT_S: Final = 0.25
"""Our heartbeat counts this often, and only by `step` being called."""
PLC_SILENT_S: Final = 1.5
"""A PLC heartbeat that stands longer is a lost link."""
PLC_UNREAD_S: Final = 0.5
"""So is a PLC that could not be read for longer."""
MAX_ATTEMPTS: Final = 20
MAX_SPEED_PERCENT: Final = 100
SUPPORTED: Final = frozenset(
    {
        PlcCommand.PICK,
        PlcCommand.PLACE,
        PlcCommand.PICK_AND_PLACE,
        PlcCommand.HOME,
        PlcCommand.VISION_ONLY,
        PlcCommand.GRIPPER_OPEN,
        PlcCommand.GRIPPER_CLOSE,
        PlcCommand.RECOVER,
        PlcCommand.SET_MODE,
        PlcCommand.PING,
    }
)
_PARAMETERS: Final[dict[int, tuple[int, ...]]] = {
    int(PlcCommand.RECOVER): tuple(Choice),
    int(PlcCommand.SET_MODE): tuple(Mode),
}
"""Commands whose word 8 is a number of a list."""
_SEQUENCES: Final = 65535
_AHEAD: Final = 32767


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """What one step gives. ``outputs`` go into the next exchange, after ``order`` has been journaled."""

    memory: Memory
    outputs: PlcOutputs
    order: PickOrder | None
    events: tuple[PlcEvent, ...]


def begin(boot_id: int, accepted: int, finished: PickResult | None) -> Memory:
    """The memory after a start, from what the journal knows.

    Parameters
    ----------
    boot_id : int
        0..65535, another one than at the start before.
    accepted : int
        The last sequence number accepted, 0 for none. It will not be executed again.
    finished : PickResult or None
        Its result, published again unless the PLC's first good read shows it acknowledged. For an order
        that was cut short by the end of the program the caller has made one with
        ``INTERRUPTED_BY_RESTART``. None when nothing is to be published again.

    Raises
    ------
    ValueError
        A number out of range, or a result of another order than the accepted one.
    """
    if not 0 <= boot_id <= 0xFFFF:
        raise ValueError(f"boot_id {boot_id} is not 16 bit")
    if not 0 <= accepted <= _SEQUENCES:
        raise ValueError(f"accepted sequence {accepted} is not in 0..{_SEQUENCES}")
    if finished is not None and finished.request_id != accepted:
        raise ValueError(f"result of order {finished.request_id}, but {accepted} was accepted last")
    return Memory(
        boot_id=boot_id,
        accepted=accepted,
        answered_seq=accepted,
        result=finished,
        publication=Publication.NONE if finished is None else Publication.RESTORED,
    )


def step(
    memory: Memory, inputs: PlcInputs | None, report: CellReport, finished: PickResult | None, now: float
) -> Step:
    """One poll.

    ``Step.order`` comes *before* the PLC is told: ``Step.outputs`` already carry its number as
    ``accepted_seq``, so the caller journals the order durably first and sends the outputs then. If the
    program ends in between, the order was either journaled, and ends as interrupted, or was not, and the
    PLC's number is refused as stale; in neither case is it executed twice.

    Parameters
    ----------
    memory : Memory
        Of the step before, or of `begin`.
    inputs : PlcInputs or None
        What the exchange that sent the last ``outputs`` has read; None when it failed, and in the very
        first call, which only makes the first outputs.
    report : CellReport
        What the cell thread says of itself.
    finished : PickResult or None
        The result of the order in flight, handed in exactly once.
    now : float
        Seconds, the clock of ``inputs.read_at``.

    Raises
    ------
    ValueError
        ``finished`` is not the result of the order in flight.
    """
    memory = _beat(memory, now)
    if inputs is not None:
        memory = _publish_further(memory, inputs)
    if finished is not None:
        memory = _take_result(memory, finished)
    memory, events = _watch_link(memory, inputs, now)
    memory, more = _read_controls(memory, inputs)
    events += more
    order = None
    if inputs is None:
        memory = replace(memory, polled=None)
    else:
        memory, order, refused = _read_order(memory, inputs, report)
        events += (PlcEvent.BAD_ORDER,) if refused else ()
    return Step(memory=memory, outputs=outputs_of(memory, report, now), order=order, events=events)


def withdraw(before: Memory, taken: Step, report: CellReport, code: ResultCode, now: float) -> Step:
    """The step with its order refused instead: it could not be journaled, so nobody may carry it out.

    Parameters
    ----------
    before : Memory
        What went into the step.
    taken : Step
        With the order; its outputs have not been sent.
    report, code, now
        As in `step`; what the PLC is told.
    """
    if taken.order is None:
        raise ValueError("there is no order to withdraw")
    back = replace(taken.memory, accepted=before.accepted, in_flight=before.in_flight)
    memory = _refuse(back, taken.order.request_id, code)
    return Step(memory=memory, outputs=outputs_of(memory, report, now), order=None, events=taken.events)


def _beat(memory: Memory, now: float) -> Memory:
    """Count once per period; periods in which nobody called are not made up for."""
    if memory.beat_at is None:
        return replace(memory, beat_at=now)
    if now - memory.beat_at < BEAT_S:
        return memory
    beat_at = max(memory.beat_at + BEAT_S, now - BEAT_S)
    return replace(memory, heartbeat=(memory.heartbeat + 1) & 0xFFFF, beat_at=beat_at)


def _publish_further(memory: Memory, inputs: PlcInputs) -> Memory:
    """The last outputs went out and the PLC was read: the result comes one stage further."""
    if memory.result is None:
        return memory
    sequence = memory.result.request_id
    acknowledged = inputs.result_ack_seq == sequence
    match memory.publication:
        case Publication.RESTORED:
            if acknowledged:
                return replace(memory, publication=Publication.ACKNOWLEDGED, published_seq=sequence)
            return replace(memory, publication=Publication.PAYLOAD)
        case Publication.PAYLOAD:
            return replace(memory, publication=Publication.SEQUENCE, published_seq=sequence)
        case Publication.SEQUENCE:
            return replace(memory, publication=Publication.VALID)
        case Publication.VALID if acknowledged:
            return replace(memory, publication=Publication.ACKNOWLEDGED)
        case _:
            return memory


def _take_result(memory: Memory, finished: PickResult) -> Memory:
    if finished.request_id != memory.in_flight:
        raise ValueError(f"result of order {finished.request_id}, but {memory.in_flight} is in flight")
    return replace(memory, in_flight=0, result=finished, publication=Publication.PAYLOAD)


def _watch_link(memory: Memory, inputs: PlcInputs | None, now: float) -> tuple[Memory, tuple[PlcEvent, ...]]:
    """The PLC is there while it can be read and its heartbeat counts; at first it has to be seen counting."""
    if inputs is not None:
        counted = memory.plc_heartbeat is not None and inputs.heartbeat != memory.plc_heartbeat
        memory = replace(
            memory,
            read_at=inputs.read_at,
            plc_heartbeat=inputs.heartbeat,
            plc_beat_at=inputs.read_at if counted else memory.plc_beat_at,
        )
    readable = memory.read_at is not None and now - memory.read_at <= PLC_UNREAD_S
    beating = memory.plc_beat_at is not None and now - memory.plc_beat_at <= PLC_SILENT_S
    if readable and beating:
        events = () if memory.link_ok else (PlcEvent.LINK_UP,)
        return replace(memory, link_ok=True), events
    if not memory.link_ok:
        return memory, ()
    # start over: the heartbeat has to be seen counting again, enable and reset have to be seen low
    lost = replace(memory, link_ok=False, armed=False, reset=True, plc_heartbeat=None, plc_beat_at=None)
    return lost, (PlcEvent.LINK_LOST,)


def _read_controls(memory: Memory, inputs: PlcInputs | None) -> tuple[Memory, tuple[PlcEvent, ...]]:
    """Levels and edges of the control word. Of a foreign map version only what stops is believed."""
    events: list[PlcEvent] = []
    enable = memory.enabled
    if inputs is not None:
        ours = inputs.map_version == MAP_VERSION
        enable = inputs.enable and ours
        reset = inputs.reset_fault and ours
        if inputs.abort and not memory.abort:
            events.append(PlcEvent.ABORT)
        if inputs.hold != memory.hold:
            events.append(PlcEvent.HOLD if inputs.hold else PlcEvent.UNHOLD)
        if reset and not memory.reset:
            events.append(PlcEvent.RESET)
        low_seen = ours and not inputs.enable
        memory = replace(
            memory, abort=inputs.abort, hold=inputs.hold, reset=reset, armed=memory.armed or low_seen
        )
    enabled = enable and memory.armed and memory.link_ok
    if enabled != memory.enabled:
        events.append(PlcEvent.ENABLED if enabled else PlcEvent.DISABLED)
    return replace(memory, enabled=enabled), tuple(events)


def _read_order(
    memory: Memory, inputs: PlcInputs, report: CellReport
) -> tuple[Memory, PickOrder | None, bool]:
    """Answer the sequence number the PLC shows; True when it was refused in this step."""
    sequence = inputs.cmd_seq
    same = memory.polled is not None and _content(memory.polled) == _content(inputs)
    stable = same or (inputs.crc_used and inputs.crc_ok)
    first = not memory.met and inputs.map_version == MAP_VERSION
    memory = replace(memory, polled=inputs, met=memory.met or first)
    if sequence == 0:
        if not stable:
            return memory, None, False
        answered = replace(memory, shown_seq=0, answered_seq=memory.accepted, answer=ResultCode.NONE)
        return answered, None, False
    if first and sequence != memory.accepted:
        # it was there before us and the journal does not know it: nobody can say how old it is
        return _refuse(memory, sequence, ResultCode.INTERRUPTED_BY_RESTART), None, True
    if not stable:
        return memory, None, False
    if sequence == memory.accepted:
        return _repeat(memory, inputs), None, False
    if sequence == memory.refused_seq:
        repeated = replace(memory, shown_seq=sequence, answered_seq=sequence, answer=memory.refusal)
        return repeated, None, False
    verdict = _verdict(memory, inputs, report)
    if verdict is not ResultCode.NONE:
        return _refuse(memory, sequence, verdict), None, True
    accepted = replace(
        memory,
        accepted=sequence,
        in_flight=sequence,
        shown_seq=sequence,
        answered_seq=sequence,
        answer=ResultCode.NONE,
        refused_seq=0,
        refusal=ResultCode.NONE,
    )
    return accepted, _order(inputs), False


def _repeat(memory: Memory, inputs: PlcInputs) -> Memory:
    """The last accepted order again: nothing moves; shown anew, its result is published anew."""
    publication = memory.publication
    finished = memory.result is not None and memory.result.request_id == inputs.cmd_seq
    asked_again = memory.shown_seq != inputs.cmd_seq and inputs.result_ack_seq != inputs.cmd_seq
    if finished and asked_again and publication is Publication.ACKNOWLEDGED:
        publication = Publication.PAYLOAD
    return replace(
        memory,
        shown_seq=inputs.cmd_seq,
        answered_seq=inputs.cmd_seq,
        answer=ResultCode.NONE,
        publication=publication,
    )


def _refuse(memory: Memory, sequence: int, code: ResultCode) -> Memory:
    return replace(
        memory,
        shown_seq=sequence,
        answered_seq=sequence,
        answer=code,
        refused_seq=sequence,
        refusal=code,
    )


def _verdict(memory: Memory, inputs: PlcInputs, report: CellReport) -> ResultCode:
    """NONE, or why a new order is not taken; the order of the questions is part of the contract."""
    if inputs.map_version != MAP_VERSION:
        return ResultCode.MAP_VERSION
    if inputs.crc_used and not inputs.crc_ok:
        return ResultCode.CRC
    if memory.accepted and not 0 < (inputs.cmd_seq - memory.accepted) % _SEQUENCES <= _AHEAD:
        return ResultCode.BAD_SEQUENCE
    if inputs.cmd_code not in SUPPORTED:
        return ResultCode.UNKNOWN_COMMAND
    if inputs.speed_percent > MAX_SPEED_PERCENT or inputs.max_attempts > MAX_ATTEMPTS:
        return ResultCode.BAD_PARAMETER
    if inputs.max_attempts not in _PARAMETERS.get(inputs.cmd_code, (inputs.max_attempts,)):
        return ResultCode.BAD_PARAMETER
    if memory.in_flight or memory.outstanding or report.busy:
        return ResultCode.BUSY
    if memory.abort:
        return ResultCode.ABORTED
    if not memory.enabled or memory.hold:
        return ResultCode.NOT_ENABLED
    if inputs.cmd_code in REFUSED[Mode(report.unit_mode)]:
        return ResultCode.NOT_ENABLED
    answers = report.choice_awaited and inputs.cmd_code == PlcCommand.RECOVER
    if report.fault_code or not (report.accepting or answers):
        return ResultCode.ROBOT_NOT_READY
    return ResultCode.NONE


def _content(inputs: PlcInputs) -> PlcInputs:
    """The order alone: everything that may differ between two polls of the same order set to one value."""
    return replace(
        inputs,
        heartbeat=0,
        enable=False,
        abort=False,
        hold=False,
        reset_fault=False,
        home_on_stop=False,
        result_ack_seq=0,
        read_at=0.0,
    )


def _order(inputs: PlcInputs) -> PickOrder:
    """Zeros mean the default: one attempt, the configured speeds."""
    return PickOrder(
        request_id=inputs.cmd_seq,
        command=PlcCommand(inputs.cmd_code),
        part_code=inputs.recipe,
        source_id=inputs.source_id,
        destination_id=inputs.destination_id,
        max_attempts=max(1, inputs.max_attempts),
        speed_fraction=(inputs.speed_percent or MAX_SPEED_PERCENT) / 100.0,
        pose=inputs.pose,
        dry_run=inputs.dry_run,
        received_at=inputs.read_at,
    )
