"""A gripper on digital outputs of the arm, with an input that says that a part is held.

Nothing is believed that the input does not confirm: a part that is said to be held while the jaws are open is
an error (a sensor that sticks would make every empty grip a good one).
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from drivers.errors import DeviceTimeout, DeviceUnavailable, StaleData
from drivers.interfaces import DigitalIo
from drivers.settings import RobotIoGripperSettings
from drivers.timing import Clock, StopToken
from drivers.types import Check, Grip, Pins

POLL_S: Final = 0.01


class _Told(Enum):
    """What the jaws were last told, and had the time to do. NOTHING after a start, or when cut short."""

    NOTHING = "nothing"
    OPEN = "open"
    CLOSE = "close"


def checks(settings: RobotIoGripperSettings, pins: Pins) -> tuple[Check, ...]:
    """What the pins say of a gripper that is left as it is."""
    closed = bool(pins.outputs >> settings.close_output & 1)
    held = bool(pins.inputs >> settings.holding_input & 1) is settings.holding_level
    lines = [
        Check(
            what="jaws",
            ok=True,
            found=f"output {settings.close_output} is {'on: closed' if closed else 'off: open'}",
        ),
        Check(
            what="confirm input",
            ok=closed or not held,
            found=f"input {settings.holding_input} says {'held' if held else 'nothing held'}"
            + ("" if closed or not held else ", with open jaws"),
            do="look into the jaws; then check the sensor and gripper.holding_level",
        ),
    ]
    if settings.open_output is not None:
        opening = bool(pins.outputs >> settings.open_output & 1)
        lines.append(
            Check(
                what="valve",
                ok=not (opening and closed),
                found=f"output {settings.open_output} is {'on' if opening else 'off'}",
                do="both coils are on: switch one off at the pendant, then check gripper.open_output",
            )
        )
    if settings.open_input is not None:
        says_open = bool(pins.inputs >> settings.open_input & 1)
        lines.append(
            Check(
                what="open input",
                ok=says_open is not closed,
                found=f"input {settings.open_input} says {'open' if says_open else 'not open'}",
                do="check air, the sensor's place and gripper.open_input",
            )
        )
    return tuple(lines)


class RobotIoGripper:
    """Jaws on outputs of the arm (``io``). The arm is opened and closed by its owner, not by the gripper."""

    def __init__(self, name: str, settings: RobotIoGripperSettings, io: DigitalIo, clock: Clock) -> None:
        self._name = name
        self._settings = settings
        self._io = io
        self._clock = clock
        self._open = False
        self._told = _Told.NOTHING

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._name

    def open(self) -> None:
        """Read the input once, so that an arm that is not there is noticed now. Moves nothing."""
        self._held()
        self._told = _Told.NOTHING
        self._open = True

    def close(self) -> None:
        """The outputs stay as they are: a part in the hand is not dropped."""
        self._open = False

    def release(self, *, stop: StopToken) -> None:
        """Open the jaws and wait until they are open and hold nothing.

        Raises
        ------
        DeviceTimeout
            ``open_input`` did not come.
        StaleData
            The part is said to be held still: it sticks to a finger, or the sensor sticks.
        """
        self._ready(stop)
        self._told = _Told.NOTHING
        self._switch(close=False)
        until = self._clock.now() + self._settings.opening_s
        pin = self._settings.open_input
        if pin is None:
            stop.wait(self._settings.opening_s)
        else:
            while not self._io.read_input(pin):
                if self._clock.now() >= until:
                    raise DeviceTimeout(
                        self._name,
                        f"input {pin} did not say open within {self._settings.opening_s:g} s; "
                        "check air, valve and sensor",
                    )
                stop.wait(POLL_S)
        until = self._clock.now() + self._settings.opening_s
        while self._held():
            if self._clock.now() >= until:
                raise StaleData(self._name, self._doubt("after opening"))
            stop.wait(POLL_S)
        self._told = _Told.OPEN

    def grasp(self, *, stop: StopToken) -> Grip:
        """Close the jaws; HOLDING once the input has been on for ``settle_s``, else CLOSED_EMPTY.

        `StaleData` when a part is said to be held before the jaws have closed.
        """
        self._ready(stop)
        if self._told is _Told.OPEN and self._held():
            raise StaleData(self._name, self._doubt("before closing"))
        self._told = _Told.NOTHING
        self._switch(close=True)
        until = self._clock.now() + self._settings.closing_s
        held_since: float | None = None
        while True:
            now = self._clock.now()
            held_since = (now if held_since is None else held_since) if self._held() else None
            if held_since is not None and now - held_since >= self._settings.settle_s:
                break
            if now >= until and held_since is None:
                break
            stop.wait(POLL_S)
        self._told = _Told.CLOSE
        return Grip.CLOSED_EMPTY if held_since is None else Grip.HOLDING

    def grip(self) -> Grip:
        """What the jaws hold, by the input as it is now.

        UNKNOWN when a part is said to be held by open jaws, and when nothing is held by jaws of which it is
        not known where they stand. A part that is held after a restart is HOLDING: it has to be put down.
        """
        if not self._open:
            raise DeviceUnavailable(self._name, "not open")
        match self._told, self._held():
            case (_Told.OPEN, False):
                return Grip.OPEN
            case (_Told.CLOSE, False):
                return Grip.CLOSED_EMPTY
            case (_Told.CLOSE | _Told.NOTHING, True):
                return Grip.HOLDING
            case _:
                return Grip.UNKNOWN

    def _ready(self, stop: StopToken) -> None:
        if not self._open:
            raise DeviceUnavailable(self._name, "not open")
        stop.check()

    def _held(self) -> bool:
        return self._io.read_input(self._settings.holding_input) is self._settings.holding_level

    def _switch(self, *, close: bool) -> None:
        """The coil that has to be off first, so that both are never on together."""
        closing, opening = self._settings.close_output, self._settings.open_output
        if opening is not None and close:
            self._io.set_output(opening, False)
        self._io.set_output(closing, close)
        if opening is not None and not close:
            self._io.set_output(opening, True)

    def _doubt(self, when: str) -> str:
        return (
            f"input {self._settings.holding_input} says that a part is held {when}; "
            "look into the jaws, then check the sensor"
        )
