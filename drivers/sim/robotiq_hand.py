"""A Robotiq 2F gripper as its registers: a deterministic `Hand.step(dt)`, no sockets, no clock.

Registers and fault codes: Robotiq, *2F-85 & 2F-140 Instruction Manual*, section 4. Counts 0..255, 0 is fully
open; the fingers reach from `REACH` to `REACH`, because their ends are found at activation. Seconds are
simulated.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

REACH: Final = (3.0, 228.0)
"""Where the fingers really end: open and closed, as read from a 2F-85."""
CLOSES_FROM: Final = 200
"""Sent this far the fingers are to grip; where parts are thin they wait for them well beyond half."""
STROKE_M: Final = 0.085
SPEED_M_S: Final = (0.020, 0.150)
"""At SPE 0 and 255."""
ACTIVATION_S: Final = 1.6
WRITABLE: Final = ("ACT", "GTO", "ATR", "ARD", "POS", "SPE", "FOR", "SID")
READABLE: Final = (*WRITABLE, "STA", "OBJ", "FLT", "PRE")


@dataclass(frozen=True, slots=True, kw_only=True)
class Touch:
    """What is between the fingers: where they meet it, counts; None: nothing. ``settled`` False: not known
    yet, the fingers wait at ``at``."""

    at: float | None = None
    settled: bool = True


@dataclass(slots=True, kw_only=True)
class Hand:
    """The registers, and where the fingers are.

    ``thin`` True: contact with a part is not noticed, as the manual warns of thin ones. ``latency_s`` from an
    order to its echo. ``stuck`` True: the fingers do not move. ``powered`` False: registers read ``?``.
    """

    latency_s: float = 0.02
    thin: bool = False
    stuck: bool = False
    powered: bool = True
    position: float = REACH[0]
    fault: int = 0
    orders: int = 0
    asked: dict[str, int] = field(
        default_factory=lambda: {"SPE": 255, "FOR": 255, "POS": 0, "SID": 9, "ARD": 1}
    )
    _active: int = 0
    _activating_s: float = 0.0
    _going: int = 0
    _echo: int = 0
    _pending: tuple[float, int] | None = None
    _object: int = 0

    @property
    def closing(self) -> bool:
        """Whether the fingers were last sent to close."""
        return self._going == 1 and self._echo >= CLOSES_FROM

    @property
    def active(self) -> bool:
        """Whether the activation is complete."""
        return self._active == 3

    def activate(self) -> None:
        """As by the teach pendant, done at once."""
        self._active, self.fault, self.asked["ACT"] = 3, 0, 1

    def write(self, name: str, value: int) -> None:
        """One register."""
        before = self.asked.get(name, 0)
        self.asked[name] = value
        if name == "ACT" and value != before:
            self._going, self._pending, self._object, self.fault = 0, None, 0, 0
            self._active, self._activating_s = (1, ACTIVATION_S) if value == 1 else (0, 0.0)
        elif name == "GTO" and value == 0:
            self._going = 0
        elif name in ("GTO", "POS") and self.asked.get("GTO") == 1:
            self._order()

    def _order(self) -> None:
        if self._active != 3:
            self.fault = 5 if self._active == 1 else 7
            return
        self.orders += 1
        self._pending = (self.latency_s, self.asked["POS"])

    def read(self, name: str) -> str:
        """One register as the socket words it."""
        if not self.powered:
            return "?"
        match name:
            case "STA":
                return str(self._active)
            case "OBJ":
                return str(self._object)
            case "FLT":
                return str(self.fault)
            case "PRE":
                return str(self._echo)
            case "POS":
                return str(round(self.position))
            case "GTO":
                return str(self._going)
            case _:
                return str(self.asked.get(name, 0))

    def step(self, dt: float, touch: Touch) -> None:
        """Advance by ``dt`` seconds with ``touch`` between the fingers."""
        if self._activating_s > 0.0:
            self._activating_s -= dt
            if self._activating_s <= 0.0:
                self._active, self.position = 3, REACH[0]
        if self._pending is not None:
            left, target = self._pending
            self._pending = (left - dt, target)
            if left - dt <= 0.0:
                # new or the same, an order makes the fingers try again
                self._pending, self._echo, self._going, self._object = None, target, 1, 0
        if self._going == 1 and self.fault == 0 and self._active == 3 and not self.stuck:
            self._move(dt, touch)

    def _move(self, dt: float, touch: Touch) -> None:
        share = self.asked["SPE"] / 255.0
        rate = (SPEED_M_S[0] + share * (SPEED_M_S[1] - SPEED_M_S[0])) / STROKE_M * (REACH[1] - REACH[0])
        target = min(max(float(self._echo), REACH[0]), REACH[1])
        if target < self.position:
            self.position = max(target, self.position - rate * dt)
            arrived = self.position == target
        else:
            stop = target if touch.at is None else min(target, max(touch.at, self.position))
            self.position = min(stop, self.position + rate * dt)
            arrived = self.position == stop
        if not arrived or not touch.settled:
            self._object = 0
        elif touch.at is not None and self.position < target and not self.thin:
            self._object = 2
        else:
            self._object = 3
