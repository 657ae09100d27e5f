"""The codec of register map v1: records of `drivers.types` to 16-bit words and back. Pure.

One table row after the other, so that a new register is a row in `drivers.plc_map`, a field of the record
and a line here; the tests compare the three.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal, TypeAlias

from drivers.plc_map import (
    COMMAND,
    COMMAND_WORDS,
    CRC_OFFSET,
    CRC_WORDS,
    STATUS,
    STATUS_WORDS,
    TEST,
    Kind,
    Register,
)
from drivers.types import PlcInputs, PlcOutputs, ToolPose

WordOrder: TypeAlias = Literal["big", "little"]


def crc16(words: Sequence[int]) -> int:
    """CRC-16 with the Modbus polynomial (reflected 0xA001, start 0xFFFF), high byte of each word first.

    >>> hex(crc16([0x3132, 0x3334]))
    '0x30ba'
    """
    crc = 0xFFFF
    for word in words:
        for byte in (word >> 8, word & 0xFF):
            crc ^= byte
            for _ in range(8):
                crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def encode_command(inputs: PlcInputs, word_order: WordOrder = "big") -> list[int]:
    """The 24 words a PLC shows for this record; ``read_at`` does not travel.

    With ``crc_used`` the check word is computed. A check word that comes out as 0 reads as "not used";
    the reader then falls back on seeing the order twice.

    Raises
    ------
    ValueError
        A value does not fit its register (the message names both), or ``crc_ok`` is False: a writer
        does not write a wrong check word.
    """
    if not inputs.crc_ok:
        raise ValueError("command.crc: a record with a wrong check word cannot be written")
    words = _encode("command", COMMAND, COMMAND_WORDS, _command_values(inputs), word_order)
    if inputs.crc_used:
        words[CRC_OFFSET] = crc16(words[CRC_WORDS])
    return words


def decode_command(words: Sequence[int], read_at: float, word_order: WordOrder = "big") -> PlcInputs:
    """The record in 24 words read at ``read_at``; never judges, `crc_ok` and ``map_version`` say it.

    Raises
    ------
    ValueError
        Not 24 words of 16 bit.
    """
    v = _decode("command", COMMAND, COMMAND_WORDS, words, word_order)
    crc = words[CRC_OFFSET]
    return PlcInputs(
        map_version=int(v["map_version"]),
        heartbeat=int(v["heartbeat"]),
        enable=bool(v["enable"]),
        abort=bool(v["abort"]),
        hold=bool(v["hold"]),
        reset_fault=bool(v["reset_fault"]),
        dry_run=bool(v["dry_run"]),
        home_on_stop=bool(v["home_on_stop"]),
        cmd_seq=int(v["cmd_seq"]),
        cmd_code=int(v["cmd_code"]),
        recipe=int(v["recipe"]),
        source_id=int(v["source_id"]),
        destination_id=int(v["destination_id"]),
        max_attempts=int(v["max_attempts"]),
        speed_percent=int(v["speed_percent"]),
        pose=_pose_of(v),
        crc_used=crc != 0,
        crc_ok=crc in (0, crc16(words[CRC_WORDS])),
        result_ack_seq=int(v["result_ack_seq"]),
        read_at=read_at,
    )


def encode_status(outputs: PlcOutputs, word_order: WordOrder = "big") -> list[int]:
    """The 40 words the cell shows for this record.

    Raises
    ------
    ValueError
        A value does not fit its register; the message names both.
    """
    return _encode("status", STATUS, STATUS_WORDS, _status_values(outputs), word_order)


def decode_status(words: Sequence[int], word_order: WordOrder = "big") -> PlcOutputs:
    """The record in 40 words.

    Raises
    ------
    ValueError
        Not 40 words of 16 bit.
    """
    v = _decode("status", STATUS, STATUS_WORDS, words, word_order)
    return PlcOutputs(
        map_version=int(v["map_version"]),
        heartbeat=int(v["heartbeat"]),
        ready=bool(v["ready"]),
        busy=bool(v["busy"]),
        moving=bool(v["moving"]),
        result_valid=bool(v["result_valid"]),
        fault=bool(v["fault"]),
        emergency_stop=bool(v["emergency_stop"]),
        protective_stop=bool(v["protective_stop"]),
        safeguard_stop=bool(v["safeguard_stop"]),
        robot_link=bool(v["robot_link"]),
        remote_control=bool(v["remote_control"]),
        program_running=bool(v["program_running"]),
        vision_ok=bool(v["vision_ok"]),
        plc_link_ok=bool(v["plc_link_ok"]),
        part_in_gripper=bool(v["part_in_gripper"]),
        at_home=bool(v["at_home"]),
        operator_needed=bool(v["operator_needed"]),
        state=int(v["state"]),
        accepted_seq=int(v["accepted_seq"]),
        ack_code=int(v["ack_code"]),
        result_seq=int(v["result_seq"]),
        result_code=int(v["result_code"]),
        result_detail=int(v["result_detail"]),
        quantity=int(v["quantity"]),
        part_type=int(v["part_type"]),
        confidence=v["confidence"],
        pose=_pose_of(v),
        cycle_time_s=v["cycle_time"],
        total_picks=int(v["total_picks"]),
        robot_mode=int(v["robot_mode"]),
        safety_mode=int(v["safety_mode"]),
        runtime_state=int(v["runtime_state"]),
        fault_code=int(v["fault_code"]),
        fault_count=int(v["fault_count"]),
        plc_link_age_s=v["plc_link_age"],
        active_recipe=int(v["active_recipe"]),
        actual_speed_percent=int(v["actual_speed_percent"]),
        boot_id=int(v["boot_id"]),
        first_alarm=int(v["first_alarm"]),
        alarm_count=int(v["alarm_count"]),
        unit_mode=int(v["unit_mode"]),
    )


def encode_example(register: Register, word_order: WordOrder = "big") -> list[int]:
    """The one or two words of a register's example; of a BITS register with its lowest named bit on."""
    values = {register.name: register.example, **{bit.name: 0 for bit in register.bits}}
    if register.bits:
        values[register.bits[0].name] = 1
    words = _encode("example", (register,), register.offset + register.kind.words, values, word_order)
    return words[register.offset :]


def encode_test(word_order: WordOrder = "big") -> list[int]:
    """The fixed words of the test registers."""
    words = [word for register in TEST for word in encode_example(register, word_order)]
    words[-1] = 1 if word_order == "big" else 2
    return words


def read_test(words: Sequence[int]) -> WordOrder | None:
    """The word order in which these are the test registers; None when in neither.

    >>> read_test(encode_test("little"))
    'little'
    """
    orders: tuple[WordOrder, ...] = ("big", "little")
    return next((order for order in orders if list(words) == encode_test(order)), None)


def _pose_of(values: Mapping[str, float]) -> ToolPose:
    return ToolPose(
        x=values["x"], y=values["y"], z=values["z"], rx=values["rx"], ry=values["ry"], rz=values["rz"]
    )


def _pose_values(pose: ToolPose) -> Mapping[str, float]:
    return dict(zip(("x", "y", "z", "rx", "ry", "rz"), pose.six(), strict=True))


def _command_values(c: PlcInputs) -> Mapping[str, float]:
    return {
        "map_version": c.map_version,
        "heartbeat": c.heartbeat,
        "enable": c.enable,
        "abort": c.abort,
        "hold": c.hold,
        "reset_fault": c.reset_fault,
        "dry_run": c.dry_run,
        "home_on_stop": c.home_on_stop,
        "cmd_seq": c.cmd_seq,
        "cmd_code": c.cmd_code,
        "recipe": c.recipe,
        "source_id": c.source_id,
        "destination_id": c.destination_id,
        "max_attempts": c.max_attempts,
        "speed_percent": c.speed_percent,
        **_pose_values(c.pose),
        "crc": 0,
        "result_ack_seq": c.result_ack_seq,
    }


def _status_values(s: PlcOutputs) -> Mapping[str, float]:
    return {
        "map_version": s.map_version,
        "heartbeat": s.heartbeat,
        "ready": s.ready,
        "busy": s.busy,
        "moving": s.moving,
        "result_valid": s.result_valid,
        "fault": s.fault,
        "emergency_stop": s.emergency_stop,
        "protective_stop": s.protective_stop,
        "safeguard_stop": s.safeguard_stop,
        "robot_link": s.robot_link,
        "remote_control": s.remote_control,
        "program_running": s.program_running,
        "vision_ok": s.vision_ok,
        "plc_link_ok": s.plc_link_ok,
        "part_in_gripper": s.part_in_gripper,
        "at_home": s.at_home,
        "operator_needed": s.operator_needed,
        "state": s.state,
        "accepted_seq": s.accepted_seq,
        "ack_code": s.ack_code,
        "result_seq": s.result_seq,
        "result_code": s.result_code,
        "result_detail": s.result_detail,
        "quantity": s.quantity,
        "part_type": s.part_type,
        "confidence": s.confidence,
        **_pose_values(s.pose),
        "cycle_time": s.cycle_time_s,
        "total_picks": s.total_picks,
        "robot_mode": s.robot_mode,
        "safety_mode": s.safety_mode,
        "runtime_state": s.runtime_state,
        "fault_code": s.fault_code,
        "fault_count": s.fault_count,
        "plc_link_age": s.plc_link_age_s,
        "active_recipe": s.active_recipe,
        "actual_speed_percent": s.actual_speed_percent,
        "boot_id": s.boot_id,
        "first_alarm": s.first_alarm,
        "alarm_count": s.alarm_count,
        "unit_mode": s.unit_mode,
    }


def _encode(
    block: str, table: tuple[Register, ...], size: int, values: Mapping[str, float], order: WordOrder
) -> list[int]:
    words = [0] * size
    for register in table:
        if register.kind is Kind.BITS:
            words[register.offset] = sum(1 << bit.number for bit in register.bits if values[bit.name])
            continue
        count = _count(block, register, values[register.name])
        if register.kind.words == 1:
            words[register.offset] = count & 0xFFFF
            continue
        pair = (count >> 16 & 0xFFFF, count & 0xFFFF)
        words[register.offset : register.offset + 2] = pair if order == "big" else pair[::-1]
    return words


def _count(block: str, register: Register, value: float) -> int:
    """The value in counts of the register, refused when it does not fit."""
    if not math.isfinite(value):
        raise ValueError(f"{block}.{register.name}: {value} is not a number")
    count = round(value * register.per_unit)
    width = 16 * register.kind.words
    low, high = (-(1 << width - 1), (1 << width - 1) - 1) if register.kind.signed else (0, (1 << width) - 1)
    if not low <= count <= high:
        unit = f" {register.unit}" if register.unit else ""
        raise ValueError(
            f"{block}.{register.name}: {value}{unit} is outside "
            f"{low / register.per_unit:g}..{high / register.per_unit:g} ({register.kind.value})"
        )
    return count


def _decode(
    block: str, table: tuple[Register, ...], size: int, words: Sequence[int], order: WordOrder
) -> Mapping[str, float]:
    if len(words) != size:
        raise ValueError(f"{block}: {len(words)} words instead of {size}")
    if not all(0 <= word <= 0xFFFF for word in words):
        raise ValueError(f"{block}: a word is not 16 bit: {list(words)}")
    values: dict[str, float] = {}
    for register in table:
        if register.kind is Kind.BITS:
            values.update({bit.name: words[register.offset] >> bit.number & 1 for bit in register.bits})
            continue
        count = words[register.offset]
        if register.kind.words == 2:
            high, low = (0, 1) if order == "big" else (1, 0)
            count = words[register.offset + high] << 16 | words[register.offset + low]
        sign = 1 << 16 * register.kind.words - 1
        if register.kind.signed and count & sign:
            count -= sign << 1
        values[register.name] = count if register.per_unit == 1 else count / register.per_unit
    return values
