"""What the PLC handshake remembers between two polls, and what of it the PLC is shown."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import Final

from cell.types import CellReport, PickResult
from drivers.types import PlcInputs, PlcOutputs, ResultCode, ToolPose

MAP_VERSION: Final = PlcOutputs().map_version

_OLDEST_AGE_S: Final = 65.535
_ORIGIN: Final = ToolPose(x=0.0, y=0.0, z=0.0, rx=0.0, ry=0.0, rz=0.0)


class PlcEvent(Enum):
    """What changed at the PLC in this step."""

    LINK_UP = "link_up"
    LINK_LOST = "link_lost"
    ABORT = "abort"
    HOLD = "hold"
    UNHOLD = "unhold"
    RESET = "reset"
    ENABLED = "enabled"
    DISABLED = "disabled"
    BAD_ORDER = "bad_order"


class Publication(Enum):
    """How far the last result has come on its way to the PLC."""

    NONE = "none"
    RESTORED = "restored"
    PAYLOAD = "payload"
    SEQUENCE = "sequence"
    VALID = "valid"
    ACKNOWLEDGED = "acknowledged"


_OUTSTANDING: Final = frozenset(
    {Publication.RESTORED, Publication.PAYLOAD, Publication.SEQUENCE, Publication.VALID}
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Memory:
    """All the handshake remembers. Sequence numbers are 0 for none; instants are None for never.

    ``accepted`` is the last order accepted, ``in_flight`` the same number until its result is there.
    ``answered_seq`` and ``answer`` are what the PLC is told; ``refused_seq`` keeps the last refusal.
    ``link_ok``: the PLC is read and its heartbeat counts. ``armed``: enable has been low since the link was
    last lost. ``enabled``: link, armed and enable together. ``met``: a first good read has been judged.
    """

    boot_id: int
    accepted: int = 0
    in_flight: int = 0
    answered_seq: int = 0
    answer: ResultCode = ResultCode.NONE
    refused_seq: int = 0
    refusal: ResultCode = ResultCode.NONE
    shown_seq: int = 0
    polled: PlcInputs | None = None
    met: bool = False
    result: PickResult | None = None
    publication: Publication = Publication.NONE
    published_seq: int = 0
    heartbeat: int = 0
    beat_at: float | None = None
    plc_heartbeat: int | None = None
    plc_beat_at: float | None = None
    read_at: float | None = None
    link_ok: bool = False
    armed: bool = True
    enabled: bool = False
    abort: bool = False
    hold: bool = False
    reset: bool = True

    @property
    def outstanding(self) -> bool:
        """There is a result the PLC has not acknowledged."""
        return self.publication in _OUTSTANDING


def outputs_of(memory: Memory, report: CellReport, now: float) -> PlcOutputs:
    """The status block: the handshake's own words from ``memory``, the rest from ``report``.

    ``cmd_seq`` 0 shows the last accepted order as answered, which is where a PLC that has lost its counter
    finds the number to go on from.
    """
    publishing = memory.outstanding and memory.publication is not Publication.VALID
    age_s = _OLDEST_AGE_S if memory.read_at is None else min(max(0.0, now - memory.read_at), _OLDEST_AGE_S)
    outputs = PlcOutputs(
        map_version=MAP_VERSION,
        heartbeat=memory.heartbeat,
        ready=(
            report.accepting
            and not report.busy
            and not report.fault_code
            and memory.enabled
            and not memory.abort
            and not memory.hold
            and not memory.in_flight
            and not memory.outstanding
        ),
        busy=bool(memory.in_flight) or publishing or report.busy,
        moving=report.moving,
        result_valid=memory.publication is Publication.VALID,
        fault=report.fault_code != 0,
        emergency_stop=report.emergency_stop,
        protective_stop=report.protective_stop,
        safeguard_stop=report.safeguard_stop,
        robot_link=report.robot_link,
        remote_control=report.remote_control,
        program_running=report.program_running,
        vision_ok=report.vision_ok,
        plc_link_ok=memory.link_ok,
        part_in_gripper=report.part_in_gripper,
        at_home=report.at_home,
        operator_needed=report.operator_needed,
        state=report.state,
        accepted_seq=memory.answered_seq,
        ack_code=int(memory.answer),
        result_seq=memory.published_seq,
        total_picks=report.total_picks % 2**32,
        safety_mode=report.safety_mode,
        fault_code=report.fault_code,
        fault_count=report.fault_count % 2**16,
        plc_link_age_s=age_s,
        active_recipe=report.recipe,
        actual_speed_percent=report.speed_percent,
        boot_id=memory.boot_id,
        first_alarm=report.first_alarm,
        alarm_count=report.alarm_count,
        unit_mode=report.unit_mode,
    )
    result = memory.result
    if result is None:
        return outputs
    return replace(
        outputs,
        result_code=int(result.code),
        result_detail=result.detail,
        quantity=result.quantity,
        part_type=result.part_type,
        confidence=result.confidence,
        pose=result.pose or _ORIGIN,
        cycle_time_s=result.took_s,
    )
