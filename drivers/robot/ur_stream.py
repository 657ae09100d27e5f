"""What the arm says of itself, as it says it: one RTDE connection with a thread that reads it all the time.

The thread is needed because the controller hangs up on a client that does not read. How old the news is is
judged by the controller's own clock: a link that delivers late, or repeats its last frame, is no fresh one.
Digital outputs are switched over the same connection, and read back.
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Final

from drivers.errors import CommandRejected, DeviceTimeout, DeviceUnavailable, StaleData
from drivers.robot.rtde import NOT_FOUND, Connection, Kind, Recipe, RtdeError, Value, Version
from drivers.robot.ur_codes import may_move, safety_of
from drivers.timing import Clock, StopToken
from drivers.types import SafetyMode, Six, Three

CONNECT_S: Final = 1.0
RATE_HZ: Final = 125.0
STALE_S: Final = 0.25
"""News older than this is none."""
GRACE_S: Final = 0.03
"""For the thread to read what has come, where the whole process was held up."""
OUTPUT_S: Final = 0.3
"""How long an output may take to follow."""
_READ_S: Final = 0.05
_POLL_S: Final = 0.004
_WINDOW_S: Final = 5.0
_REST_RAD_S: Final = 0.01
"""Joints that turn slower than this stand: what encoders show of an arm at rest."""

_STATE: Final = (
    "timestamp",
    "actual_q",
    "actual_qd",
    "target_qd",
    "actual_TCP_pose",
    "robot_mode",
    "safety_mode",
    "safety_status_bits",
    "robot_status_bits",
    "runtime_state",
    "speed_scaling",
    "target_speed_fraction",
    "actual_digital_input_bits",
    "actual_digital_output_bits",
    "payload",
    "payload_cog",
)

_GROUPS: Final = ("standard", "configurable", "tool")
_FIRST_PIN: Final = (0, 8, 16)
PINS: Final = 18
"""0-7 standard, 8-15 configurable, 16-17 at the tool, as the controller numbers its bits."""


def inputs_of(group: str) -> tuple[str, str]:
    """The two RTDE variables that switch a group of outputs."""
    return (f"{group}_digital_output_mask", f"{group}_digital_output")


OUTPUT_INPUTS: Final = tuple(inputs_of(group) for group in _GROUPS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """One frame of the controller's state. Metres, radians, seconds; ``at`` is when it came, our clock.

    ``ready`` and ``operation`` are what the library's program on the controller says of itself: whether it
    takes commands, and the word about its latest motion (see `operation_id`, `operation_runs`).
    """

    controller_time_s: float
    at: float
    q_rad: Six
    speeds_rad_s: Six
    wanted_speeds_rad_s: Six
    tool: Six
    robot_mode: int
    safety: SafetyMode
    runtime: int
    speed_fraction: float
    inputs: int
    outputs: int
    payload_kg: float
    payload_cog_m: Three
    ready: int
    operation: int

    @property
    def operation_id(self) -> int:
        """Which motion the program began last: 0 to 127, then from 0 again."""
        return (self.operation >> 24) & 0x7F

    @property
    def operation_runs(self) -> bool:
        """Whether that motion is under way."""
        return bool(self.operation & (1 << 15))

    @property
    def moving(self) -> bool:
        """Whether the arm moves, or is told to."""
        return any(self.wanted_speeds_rad_s) or max(abs(v) for v in self.speeds_rad_s) > _REST_RAD_S

    @property
    def may_move(self) -> bool:
        """Whether its safety system lets it."""
        return may_move(self.safety)


def _six(value: Value) -> Six:
    assert isinstance(value, tuple)
    a, b, c, d, e, f = (float(v) for v in value)
    return (a, b, c, d, e, f)


def _three(value: Value) -> Three:
    assert isinstance(value, tuple)
    a, b, c = (float(v) for v in value)
    return (a, b, c)


def _number(value: Value) -> float:
    assert not isinstance(value, tuple)
    return float(value)


def snapshot_of(values: dict[str, Value], at: float, offset: int) -> Snapshot:
    """A frame's values as a record; ``offset`` is 0 or 24, where the program's registers begin."""
    return Snapshot(
        controller_time_s=_number(values["timestamp"]),
        at=at,
        q_rad=_six(values["actual_q"]),
        speeds_rad_s=_six(values["actual_qd"]),
        wanted_speeds_rad_s=_six(values["target_qd"]),
        tool=_six(values["actual_TCP_pose"]),
        robot_mode=int(_number(values["robot_mode"])),
        safety=safety_of(int(_number(values["safety_mode"])), int(_number(values["safety_status_bits"]))),
        runtime=int(_number(values["runtime_state"])),
        speed_fraction=_number(values["target_speed_fraction"]),
        inputs=int(_number(values["actual_digital_input_bits"])),
        outputs=int(_number(values["actual_digital_output_bits"])),
        payload_kg=_number(values["payload"]),
        payload_cog_m=_three(values["payload_cog"]),
        ready=int(_number(values[f"output_int_register_{offset}"])),
        operation=int(_number(values[f"output_int_register_{2 + offset}"])),
    )


class Ageing:
    """How old news is, by the sender's clock.

    The smallest difference between arrival and the sender's time is the quickest a frame ever came; what a
    frame takes longer than that is its age. Smallest within the last two windows: clocks drift apart.

    >>> ageing = Ageing()
    >>> ageing.came(100.0, 5.000); ageing.came(100.008, 5.208)
    >>> round(ageing.age_s(5.208), 3)  # came 0.2 s later than it should have
    0.2
    """

    def __init__(self) -> None:
        self._sent_at = float("-inf")
        self._least = self._least_before = float("inf")
        self._window_from = float("-inf")

    def came(self, sent_at: float, now: float) -> bool:
        """Note a frame; False when the sender's clock has not moved."""
        if sent_at == self._sent_at:
            return False
        if sent_at < self._sent_at:  # it started anew
            self._least = self._least_before = float("inf")
        self._sent_at = sent_at
        if now - self._window_from > _WINDOW_S:
            self._least_before, self._least = self._least, float("inf")
            self._window_from = now
        self._least = min(self._least, now - sent_at)
        return True

    def age_s(self, now: float) -> float:
        """Age of the newest frame, seconds."""
        return now - (self._sent_at + min(self._least, self._least_before))


class UrStream:
    """The connection and its thread, which calls ``doubt`` once when the link cannot be trusted."""

    def __init__(self, name: str, clock: Clock, offset: int, doubt: Callable[[str], None]) -> None:
        self._name = name
        self._clock = clock
        self._offset = offset
        self._doubt = doubt
        self._lock = threading.Lock()
        self._connection: Connection | None = None
        self._thread: threading.Thread | None = None
        self._ends = threading.Event()
        self._never = threading.Event()
        self._recipe: Recipe | None = None
        self._outputs: dict[str, Recipe] = {}
        self._ageing = Ageing()
        self._newest: Snapshot | None = None
        self._lost: str | None = None
        self.version: Version | None = None

    # ------------------------------------------------------------------ open and close

    def open(self, host: str) -> None:
        """Connect, agree and wait for the first frame; all or nothing.

        Raises
        ------
        DeviceUnavailable, DeviceTimeout, CommandRejected
        """
        self.close()
        connection = Connection(self._clock.now)
        with ExitStack() as undo:
            undo.callback(connection.close)
            try:
                connection.open(host, CONNECT_S)
                self.version = connection.controller_version(CONNECT_S)
                self._agree(connection)
                connection.start(CONNECT_S)
                self._first(connection)
            except TimeoutError as error:
                raise DeviceTimeout(self._name, f"RTDE at {host}: {error}") from error
            except (OSError, RtdeError, struct.error) as error:
                raise DeviceUnavailable(self._name, f"RTDE at {host}: {error}") from error
            undo.pop_all()
        self._connection = connection
        self._ends.clear()
        self._thread = threading.Thread(
            target=self._read, args=(connection,), name=f"{self._name}.stream", daemon=True
        )
        self._thread.start()

    def _agree(self, connection: Connection) -> None:
        program = (f"output_int_register_{self._offset}", f"output_int_register_{2 + self._offset}")
        recipe = connection.outputs((*_STATE, *program), RATE_HZ, CONNECT_S)
        if not recipe.usable:
            raise CommandRejected(
                self._name,
                f"PolyScope {self.version} does not tell {', '.join(recipe.missing(NOT_FOUND))}; "
                "update it to 5.6 or later",
            )
        self._recipe = recipe
        self._outputs = {group: connection.inputs(inputs_of(group), CONNECT_S) for group in _GROUPS}

    def _first(self, connection: Connection) -> None:
        self._ageing = Ageing()
        self._newest = self._lost = None
        until = self._clock.now() + CONNECT_S
        while self._newest is None:
            left_s = until - self._clock.now()
            if left_s <= 0.0:
                raise TimeoutError(f"no data within {CONNECT_S:.0f} s")
            self._take(connection, left_s)

    def close(self) -> None:
        """End the thread and hang up; may come twice."""
        self._ends.set()
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(1.0)

    # ------------------------------------------------------------------ the thread

    def _read(self, connection: Connection) -> None:
        told = False
        while not self._ends.is_set():
            try:
                self._take(connection, _READ_S)
            except (OSError, RtdeError) as error:
                if not self._ends.is_set():
                    self._lose(str(error) or type(error).__name__)
                return
            with self._lock:
                age_s = self._ageing.age_s(self._clock.now())
            if age_s > STALE_S and not told:
                told = True
                self._doubt(f"its news is {age_s:.2f} s old")
            elif age_s <= STALE_S:
                told = False

    def _lose(self, why: str) -> None:
        with self._lock:
            self._lost = why
        self._doubt(f"RTDE connection lost: {why}")

    def _take(self, connection: Connection, timeout_s: float) -> None:
        """Read what has come; only the newest frame counts."""
        frames = [one for one in connection.receive(timeout_s) if one.kind == Kind.DATA]
        if not frames or self._recipe is None:
            return
        now = self._clock.now()
        snapshot = snapshot_of(self._recipe.unpack(frames[-1].body), now, self._offset)
        with self._lock:
            self._newest = snapshot
            self._ageing.came(snapshot.controller_time_s, now)

    # ------------------------------------------------------------------ for the arm

    def latest(self) -> Snapshot:
        """The newest frame. Waits `GRACE_S` at most, and only where it is old.

        Raises
        ------
        DeviceUnavailable
            The connection is lost, or not open.
        StaleData
            It is older than `STALE_S`.
        """
        until = self._clock.now() + GRACE_S
        while True:
            with self._lock:
                snapshot, lost = self._newest, self._lost
                age_s = self._ageing.age_s(self._clock.now())
            if age_s <= STALE_S or lost is not None or self._clock.now() >= until:
                break
            # this process may have been held up as a whole: what came meanwhile is not read yet
            self._clock.wait(self._never, _POLL_S)
        if self._connection is None or snapshot is None:
            raise DeviceUnavailable(self._name, "not open")
        if lost is not None:
            raise DeviceUnavailable(self._name, f"RTDE connection lost: {lost}")
        if age_s > STALE_S:
            raise StaleData(self._name, f"the newest state is {age_s:.2f} s old by the controller's clock")
        return snapshot

    def age_s(self) -> float:
        """How old the newest frame is, by the controller's clock."""
        with self._lock:
            return self._ageing.age_s(self._clock.now())

    def switch(self, pin: int, on: bool) -> None:
        """Switch a digital output and see it follow.

        Raises
        ------
        CommandRejected
            No such output, or another client holds it.
        DeviceTimeout
            It did not follow.
        DeviceUnavailable, StaleData
        """
        if not 0 <= pin < PINS:
            raise CommandRejected(self._name, f"no digital output {pin}; there are 0 to {PINS - 1}")
        group = max(g for g in range(len(_GROUPS)) if _FIRST_PIN[g] <= pin)
        name, bit = _GROUPS[group], 1 << (pin - _FIRST_PIN[group])
        recipe = self._outputs.get(name)
        if recipe is None or not recipe.usable:
            raise CommandRejected(
                self._name,
                f"digital output {pin}: the {name} outputs are held by another RTDE client or a fieldbus; "
                "end that client, or take the outputs from it in the installation",
            )
        self.latest()
        self._send(recipe, bit, bit if on else 0)
        until = self._clock.now() + OUTPUT_S
        waiting = StopToken(self._clock)
        while bool(self.latest().outputs >> pin & 1) is not on:
            if self._clock.now() >= until:
                raise DeviceTimeout(
                    self._name,
                    f"digital output {pin} did not turn {'on' if on else 'off'} within {OUTPUT_S:.1f} s",
                )
            waiting.wait(_POLL_S)
        self._send(recipe, 0, 0)  # let go: the panel may switch it as well

    def outputs_in_use(self) -> tuple[str, ...]:
        """Groups of outputs that another client holds."""
        return tuple(group for group, recipe in self._outputs.items() if not recipe.usable)

    def _send(self, recipe: Recipe, mask: int, value: int) -> None:
        if self._connection is None:
            raise DeviceUnavailable(self._name, "not open")
        try:
            self._connection.put(recipe.pack((mask, value)))
        except (OSError, RtdeError) as error:
            raise DeviceUnavailable(self._name, f"RTDE connection lost: {error}") from error
