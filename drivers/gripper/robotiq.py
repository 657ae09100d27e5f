"""A Robotiq 2F gripper over the socket of its URCap (port 63352 of the UR controller).

One line of text a question: ``SET POS 255 SPE 255 FOR 10 GTO 1`` is answered ``ack`` (without an end of
line), ``GET POS`` with ``POS 228``. Variables are the gripper's registers (Robotiq, *2F-85 & 2F-140
Instruction Manual*, section 4). Without power at the tool flange, after an emergency stop for one, the value
is ``?``.

A register read tells of the past: after an order the fingers may still be said to stand where they stood. An
order counts as received once its position is echoed (PRE), as done once the fingers stand and are not where
they were told to leave.
"""

from __future__ import annotations

import socket
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Final, NoReturn

from drivers.errors import CommandRejected, DeviceTimeout, DeviceUnavailable
from drivers.settings import RobotiqGripperSettings
from drivers.timing import Clock, StopToken
from drivers.types import Check, Grip

POLL_S: Final = 0.02
CONNECT_S: Final = 1.0
ACTIVATION_S: Final = 10.0
"""How long the fingers may take to find both ends of their way."""
NEAR: Final = 4
"""Counts: the fingers stop within this of the position they are sent to."""
ANSWER_LIMIT: Final = 256
_ACK: Final = b"ack"
_ACTIVE: Final = 3
_MOVING: Final = 0

FAULTS: Final = {
    5: "the activation is not finished",
    7: "it is not activated",
    8: "too hot (85 °C inside); let it cool down",
    9: "no communication for a second; check the tool connector and its cable",
    10: "supply voltage too low",
    11: "automatic release is under way",
    12: "internal fault; ask Robotiq",
    13: "activation failed; is something between the fingers?",
    14: "overcurrent",
    15: "automatic release has opened the fingers",
}
"""``FLT``; from 10 on only a new activation clears it, and that moves the fingers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """The registers one decision needs. ``position`` 0 is fully open."""

    active: int
    fault: int
    going: bool
    detection: int
    asked: int
    position: int


def checks(settings: RobotiqGripperSettings, clock: Clock) -> tuple[Check, ...]:
    """What the registers say of a gripper that is left as it is."""
    reader = RobotiqGripper("gripper", settings, clock)
    try:
        status = reader.look()
    except (DeviceUnavailable, DeviceTimeout, CommandRejected) as error:
        do = "check robot and tool cable, the gripper's URCap, and gripper.host"
        return (Check(what="answer", ok=False, found=error.detail, do=do),)
    finally:
        reader.close()
    text = "none" if status.fault == 0 else FAULTS.get(status.fault, "unknown to this driver")
    return (
        Check(what="answer", ok=True, found=f"{settings.host}:{settings.port}"),
        Check(
            what="activation",
            ok=status.active == _ACTIVE or settings.activate,
            found="active" if status.active == _ACTIVE else f"STA {status.active}",
            do="activate it on the teach pendant, with nothing between the fingers",
        ),
        Check(
            what="fault",
            ok=status.fault == 0,
            found=f"{status.fault}: {text}",
            do="activate it anew on the teach pendant, with nothing between the fingers",
        ),
        Check(what="fingers", ok=True, found=f"at {status.position} of 255"),
    )


class RobotiqGripper:
    """Two fingers of which one knows where they stand."""

    def __init__(self, name: str, settings: RobotiqGripperSettings, clock: Clock) -> None:
        self._name = name
        self._settings = settings
        self._clock = clock
        self._socket: socket.socket | None = None
        self._opened = False

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._name

    def open(self) -> None:
        """Connect, and refuse a gripper that is not activated or has a fault.

        The fingers move only where it has to be activated and ``activate`` is set.
        """
        self._opened = True
        with ExitStack() as undo:
            undo.callback(self.close)
            status = self._status()
            if status.active != _ACTIVE and status.fault in (0, 5, 7) and self._settings.activate:
                self._activate()
                status = self._status()
            self._refuse_unfit(status)
            undo.pop_all()

    def close(self) -> None:
        """Disconnect; the fingers stay as they are."""
        self._opened = False
        self._drop()

    def release(self, *, stop: StopToken) -> None:
        """Open the fingers and wait until they are open.

        `CommandRejected` when something stops them on the way, `DeviceTimeout` when they do not come.
        """
        status = self._go(self._settings.open_position, stop)
        if abs(status.position - self._settings.open_position) > NEAR:
            raise CommandRejected(
                self._name,
                f"the fingers stopped at {status.position} on their way to {self._settings.open_position}; "
                "is something in their way?",
            )

    def grasp(self, *, stop: StopToken) -> Grip:
        """Close the fingers and say what they got."""
        return self._judged(self._go(self._settings.close_position, stop))

    def grip(self) -> Grip:
        """What the fingers hold now; UNKNOWN while they move."""
        status = self._status()
        self._refuse_unfit(status)
        return self._judged(status)

    def look(self) -> Status:
        """The registers as they are; connects where it has to, moves nothing, refuses nothing."""
        self._opened = True
        return self._status()

    # ------------------------------------------------------------------ what the registers mean

    def _judged(self, status: Status) -> Grip:
        """By position: the gripper's own detection (2: contact, 3: none) overlooks thin parts."""
        if status.going and status.detection == _MOVING:
            return Grip.UNKNOWN
        stands_open = abs(status.position - self._settings.open_position) <= NEAR
        if not status.going or abs(status.asked - self._settings.open_position) <= NEAR:
            return Grip.OPEN if stands_open else Grip.UNKNOWN
        if status.position >= self._settings.empty_from:
            return Grip.CLOSED_EMPTY
        return Grip.UNKNOWN if stands_open else Grip.HOLDING

    def _refuse_unfit(self, status: Status) -> None:
        if status.fault != 0:
            text = FAULTS.get(status.fault, "unknown to this driver")
            self._no(f"fault {status.fault}: {text}")
        if status.active != _ACTIVE:
            self._no(f"not activated (STA {status.active})")

    def _no(self, why: str) -> NoReturn:
        raise CommandRejected(
            self._name,
            f"{why}. Activate the gripper on the teach pendant with nothing between the fingers, then reset",
        )

    # ------------------------------------------------------------------ orders

    def _go(self, position: int, stop: StopToken) -> Status:
        """Send the fingers and wait until they stand."""
        self._need_open()
        stop.check()
        start = self._status()
        self._refuse_unfit(start)
        s = self._settings
        until = self._clock.now() + s.jaws_timeout_s
        self._set(f"POS {position} SPE {s.speed} FOR {s.force} GTO 1")
        before: int | None = None
        stays = abs(start.position - position) <= NEAR or (start.asked == position and start.going)
        while True:
            status = self._status()
            self._refuse_unfit(status)
            received = status.going and status.asked == position
            left = stays or abs(status.position - start.position) > NEAR
            if received and left and status.detection != _MOVING and status.position == before:
                return status
            before = status.position
            if self._clock.now() >= until:
                raise DeviceTimeout(self._name, self._late(status, position, received=received, left=left))
            stop.wait(POLL_S)

    def _late(self, status: Status, position: int, *, received: bool, left: bool) -> str:
        if not received:
            what = f"the order to go to {position} was not taken (PRE {status.asked})"
        elif not left:
            what = f"the fingers did not leave {status.position}"
        else:
            what = f"the fingers still move at {status.position} on their way to {position}"
        return f"{what} within {self._settings.jaws_timeout_s:g} s"

    def _activate(self) -> None:
        """A rising edge of ACT; the fingers find both ends of their way."""
        resting = StopToken(self._clock)
        until = self._clock.now() + ACTIVATION_S
        self._set("ACT 0")
        while self._get("ACT") != 0:
            self._within(until, "ACT 0 was not taken")
            resting.wait(POLL_S)
        self._set("ACT 1")
        while self._get("STA") != _ACTIVE:
            self._within(until, "it does not get active")
            resting.wait(POLL_S)

    def _within(self, until: float, what: str) -> None:
        if self._clock.now() >= until:
            raise DeviceTimeout(self._name, f"{what} within {ACTIVATION_S:g} s")

    # ------------------------------------------------------------------ the wire

    def _status(self) -> Status:
        # detection before position: a position that is read later is never older
        active, fault, going = self._get("STA"), self._get("FLT"), self._get("GTO") == 1
        detection, asked = self._get("OBJ"), self._get("PRE")
        return Status(
            active=active,
            fault=fault,
            going=going,
            detection=detection,
            asked=asked,
            position=self._get("POS"),
        )

    def _set(self, assignments: str) -> None:
        answer = self._ask(f"SET {assignments}", ack=True)
        if answer != _ACK.decode():
            self._drop()
            raise CommandRejected(self._name, f"SET {assignments} was answered {answer!r}")

    def _get(self, variable: str) -> int:
        words = self._ask(f"GET {variable}", ack=False).split()
        if len(words) == 2 and words[0] == variable:
            if words[1].isdecimal():
                return int(words[1])
            if words[1] == "?":
                self._powerless()
        if words == ["?"]:
            self._powerless()
        self._drop()
        raise DeviceUnavailable(self._name, f"GET {variable} was answered {' '.join(words)!r}")

    def _powerless(self) -> NoReturn:
        raise DeviceUnavailable(
            self._name,
            "the controller does not reach it (?): the arm is off or in emergency stop, or the tool cable is "
            "loose",
        )

    def _need_open(self) -> None:
        if not self._opened:
            raise DeviceUnavailable(self._name, "not open")

    def _connected(self) -> socket.socket:
        self._need_open()
        if self._socket is None:
            address = (self._settings.host, self._settings.port)
            try:
                self._socket = socket.create_connection(address, timeout=CONNECT_S)
                self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            except OSError as error:
                self._drop()
                raise DeviceUnavailable(
                    self._name,
                    f"no gripper at {address[0]}:{address[1]}: {error}; is its URCap installed and the "
                    "controller on?",
                ) from error
        return self._socket

    def _drop(self) -> None:
        connection, self._socket = self._socket, None
        if connection is not None:
            connection.close()

    def _ask(self, line: str, *, ack: bool) -> str:
        """One line and its answer; at the first doubt the connection is given up, so that a late answer is
        never taken for the next one."""
        connection = self._connected()
        until = self._clock.now() + self._settings.timeout_s
        got = b""
        try:
            connection.sendall(line.encode("ascii") + b"\n")
            # ``ack`` comes without an end of line; one that comes all the same stands before the next answer
            while b"\n" not in got.lstrip() and not (ack and got.strip().startswith(_ACK)):
                connection.settimeout(max(0.001, until - self._clock.now()))
                part = connection.recv(ANSWER_LIMIT)
                if not part:
                    raise ConnectionError("the controller closed the connection")
                got += part
                if len(got) > ANSWER_LIMIT:
                    raise ConnectionError(f"more than {ANSWER_LIMIT} bytes in one answer")
        except TimeoutError as error:
            self._drop()
            raise DeviceTimeout(
                self._name, f"no answer to {line} within {self._settings.timeout_s:g} s"
            ) from error
        except OSError as error:
            self._drop()
            raise DeviceUnavailable(self._name, f"connection lost at {line}: {error}") from error
        return got.decode("ascii", errors="replace").strip()
