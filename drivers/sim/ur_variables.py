"""The variables of the RTDE: name, type, since which PolyScope, and how to read or write each on a `Core`.

Types and names as UR's RTDE guide lists them; sizes matter, because ur-rtde reads packages by position.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

from drivers.sim.ur_codes import RobotMode, robot_status_bits, safety_status_bits
from drivers.sim.ur_core import Core

Value: TypeAlias = float | tuple[float, ...]
Read: TypeAlias = Callable[[Core], Value]
Write: TypeAlias = Callable[[Core, tuple[float, ...]], None]
Version: TypeAlias = tuple[int, int, int]

FORMATS: Final = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
"""Each type as `struct` writes it, big-endian."""
WIDTHS: Final = {name: int(text[:-1] or 1) for name, text in FORMATS.items()}
"""How many numbers a value of each type is."""

_ZERO6 = (0.0,) * 6
_ZERO3 = (0.0,) * 3
_JOINT_RUNNING, _JOINT_POWER_OFF = 253, 239
_VOLTS = 48.0


@dataclass(frozen=True, slots=True)
class Output:
    """A variable the controller tells."""

    type: str
    read: Read
    since: Version = (0, 0, 0)


@dataclass(frozen=True, slots=True)
class Input:
    """A variable a client may write, whole packages only. ``register`` what a watchdog may watch."""

    type: str
    write: Write
    register: int | None = None


def _constant(value: Value) -> Read:
    return lambda core: value  # noqa: ARG005 - every reader takes the core


def _joint_modes(core: Core) -> Value:
    return (_JOINT_RUNNING if core.mode is RobotMode.RUNNING else _JOINT_POWER_OFF,) * 6


def _outputs() -> dict[str, Output]:
    six, double, vector3 = "VECTOR6D", "DOUBLE", "VECTOR3D"
    table = {
        "timestamp": Output(double, lambda core: core.time_s),
        "target_q": Output(six, lambda core: core.arm.q),
        "target_qd": Output(six, lambda core: core.arm.qd),
        "actual_q": Output(six, lambda core: core.arm.q),
        "actual_qd": Output(six, lambda core: core.arm.qd),
        "actual_TCP_pose": Output(six, lambda core: core.arm.pose),
        "target_TCP_pose": Output(six, lambda core: core.arm.pose),
        "actual_TCP_speed": Output(six, lambda core: core.arm.tool_speed),
        "target_TCP_speed": Output(six, lambda core: core.arm.tool_speed),
        "tcp_offset": Output(six, lambda core: core.arm.tcp),
        "actual_digital_input_bits": Output("UINT64", lambda core: core.io.inputs),
        "actual_digital_output_bits": Output("UINT64", lambda core: core.io.outputs),
        "robot_mode": Output("INT32", lambda core: int(core.mode)),
        "safety_mode": Output("INT32", lambda core: int(core.safety)),
        "safety_status": Output("INT32", lambda core: int(core.safety)),
        "joint_mode": Output("VECTOR6INT32", _joint_modes),
        "runtime_state": Output("UINT32", lambda core: int(core.runtime)),
        "robot_status_bits": Output("UINT32", lambda core: robot_status_bits(core.mode, core.runtime)),
        "safety_status_bits": Output("UINT32", lambda core: safety_status_bits(core.safety)),
        "speed_scaling": Output(double, lambda core: core.arm.fraction),
        "target_speed_fraction": Output(double, lambda core: core.arm.slider),
        "joint_temperatures": Output(six, _constant((31.0,) * 6)),
        "actual_execution_time": Output(double, _constant(0.1)),
        "actual_main_voltage": Output(double, _constant(_VOLTS)),
        "actual_robot_voltage": Output(double, _constant(_VOLTS)),
        "actual_joint_voltage": Output(six, _constant((_VOLTS,) * 6)),
        "standard_analog_output0": Output(double, lambda core: core.io.analog_outputs[0]),
        "standard_analog_output1": Output(double, lambda core: core.io.analog_outputs[1]),
        "payload": Output(double, lambda core: core.payload_kg, (5, 6, 0)),
        "payload_cog": Output(vector3, lambda core: core.payload_cog, (5, 6, 0)),
        "payload_inertia": Output(six, _constant(_ZERO6), (5, 11, 0)),
        "ft_raw_wrench": Output(six, _constant(_ZERO6), (5, 9, 0)),
        "actual_current_as_torque": Output(six, _constant(_ZERO6), (5, 23, 0)),
        "actual_tool_accelerometer": Output(vector3, _constant((0.0, 0.0, 9.81))),
        "elbow_position": Output(vector3, _constant(_ZERO3)),
        "elbow_velocity": Output(vector3, _constant(_ZERO3)),
        "tool_mode": Output("UINT32", _constant(253)),
        "analog_io_types": Output("UINT32", _constant(0)),
        "tool_output_voltage": Output("INT32", _constant(0)),
    }
    for name in ("target_qdd", "target_current", "target_moment", "actual_current", "actual_TCP_force"):
        table[name] = Output(six, _constant(_ZERO6))
    table["joint_control_output"] = Output(six, _constant(_ZERO6))
    for name in (
        "actual_momentum",
        "actual_robot_current",
        "standard_analog_input0",
        "standard_analog_input1",
        "tool_analog_input0",
        "tool_analog_input1",
        "tool_output_current",
        "tool_temperature",
        "tcp_force_scalar",
        "io_current",
    ):
        table[name] = Output(double, _constant(0.0))
    for number in range(48):
        table[f"output_int_register_{number}"] = Output("INT32", _item(lambda core: core.output_ints, number))
        table[f"output_double_register_{number}"] = Output(
            double, _item(lambda core: core.output_doubles, number)
        )
        table[f"input_int_register_{number}"] = Output("INT32", _item(lambda core: core.input_ints, number))
        table[f"input_double_register_{number}"] = Output(
            double, _item(lambda core: core.input_doubles, number)
        )
    for word, name in enumerate(("0_to_31", "32_to_63")):
        table[f"output_bit_registers{name}"] = Output("UINT32", _item(lambda core: core.output_bits, word))
        table[f"input_bit_registers{name}"] = Output("UINT32", _item(lambda core: core.input_bits, word))
    for bit in range(64, 128):
        table[f"output_bit_register_{bit}"] = Output("BOOL", _bit(lambda core: core.output_bits, bit))
        table[f"input_bit_register_{bit}"] = Output("BOOL", _bit(lambda core: core.input_bits, bit))
    return table


def _item(of: Callable[[Core], list[int] | list[float]], number: int) -> Read:
    return lambda core: of(core)[number]


def _bit(of: Callable[[Core], list[int]], bit: int) -> Read:
    return lambda core: bool(of(core)[bit // 32] >> bit % 32 & 1)


# ------------------------------------------------------------------ inputs


def _int_register(number: int) -> Write:
    def write(core: Core, values: tuple[float, ...]) -> None:
        core.input_ints[number] = int(values[0])
        core.input_written(number)

    return write


def _double_register(number: int) -> Write:
    def write(core: Core, values: tuple[float, ...]) -> None:
        core.input_doubles[number] = values[0]

    return write


def _bit_word(word: int) -> Write:
    def write(core: Core, values: tuple[float, ...]) -> None:
        core.input_bits[word] = int(values[0])

    return write


def _bit_register(bit: int) -> Write:
    def write(core: Core, values: tuple[float, ...]) -> None:
        word = core.input_bits[bit // 32] & ~(1 << bit % 32)
        core.input_bits[bit // 32] = word | bool(values[0]) << bit % 32

    return write


class Masked:
    """Inputs that act in pairs: a mask says which bits of the value count, in whatever order they come.

    The value of one package acts when its last part was written; see `settle`.
    """

    NAMES: Final = {
        "standard_digital_output": 0,
        "configurable_digital_output": 8,
        "tool_digital_output": 16,
    }

    def __init__(self) -> None:
        self._held: dict[str, float] = {}

    def hold(self, name: str, value: float) -> None:
        """Keep one part until the package is complete."""
        self._held[name] = value

    def settle(self, core: Core) -> None:
        """The package is complete: let masks and values act together."""
        held, self._held = self._held, {}
        for name, first in self.NAMES.items():
            mask, value = int(held.get(f"{name}_mask", 0)), int(held.get(name, 0))
            for bit in range(8):
                if mask >> bit & 1:
                    core.set_output_bit(first + bit, bool(value >> bit & 1))
        if held.get("speed_slider_mask", 0) and "speed_slider_fraction" in held:
            core.set_slider(held["speed_slider_fraction"])
        for channel in (0, 1):
            if int(held.get("standard_analog_output_mask", 0)) >> channel & 1:
                core.io.analog_outputs[channel] = held.get(f"standard_analog_output_{channel}", 0.0)


MASKED_TYPES: Final = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
    "configurable_digital_output_mask": "UINT8",
    "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8",
    "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
}


def _no_effect(core: Core, values: tuple[float, ...]) -> None:
    """Read and forgotten: nothing here feels forces."""


def _inputs() -> dict[str, Input]:
    table = {"external_force_torque": Input("VECTOR6D", _no_effect)}
    for number in range(48):
        table[f"input_int_register_{number}"] = Input("INT32", _int_register(number), number)
        table[f"input_double_register_{number}"] = Input("DOUBLE", _double_register(number))
    for word, name in enumerate(("0_to_31", "32_to_63")):
        table[f"input_bit_registers{name}"] = Input("UINT32", _bit_word(word))
    for bit in range(64, 128):
        table[f"input_bit_register_{bit}"] = Input("BOOL", _bit_register(bit))
    return table


OUTPUTS: Final = _outputs()
INPUTS: Final = _inputs()


def input_type(name: str) -> str | None:
    """The type of an input, None when there is no such input."""
    if name in MASKED_TYPES:
        return MASKED_TYPES[name]
    found = INPUTS.get(name)
    return None if found is None else found.type


def output_of(name: str, version: Version) -> Output | None:
    """An output this PolyScope has, None otherwise."""
    found = OUTPUTS.get(name)
    return None if found is None or version < found.since else found
