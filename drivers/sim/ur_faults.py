"""The fault port of the simulated UR controller: one JSON object a line in, one a line out.

``{"do": "status"}`` tells everything worth knowing; the others upset the controller or its wires, at once or,
with ``"at": {"moving_s": 0.2}``, at an instant of the next motion. `Faults.DOINGS` lists them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from typing import Protocol, TypeAlias

from drivers.sim.ur_codes import Safety
from drivers.sim.ur_core import REGISTERS, Armed, Core
from drivers.sim.ur_ports import Connection, How, Port, Ports
from drivers.sim.ur_request import Json, Refused, Request
from drivers.sim.ur_session import Level, Owners, text_message

Act: TypeAlias = Callable[[], None]
LONGEST_LINE = 65536


class Whole(Protocol):
    """The machine around the core: its clock can be stopped, and it may be wired to a simulated cell."""

    standing: bool

    @property
    def world(self) -> str: ...


def status_values(core: Core) -> dict[str, Json]:
    """What the controller is and has counted."""
    arm, motion = core.arm, core.arm.motion
    counts: dict[str, Json] = dict(sorted(core.counts.items()))
    events: list[Json] = list(core.events)
    return {
        "time_s": round(core.time_s, 3),
        "q": list(arm.q),
        "qd": list(arm.qd),
        "tcp": list(arm.pose),
        "tool_speed_m_s": sum(v * v for v in arm.tool_speed[:3]) ** 0.5,
        "tcp_offset": list(arm.tcp),
        "payload_kg": core.payload_kg,
        "moving": any(arm.qd),
        "motion_left": motion is not None,
        "moving_s": 0.0 if motion is None else motion.elapsed_s,
        "safety": core.safety.name,
        "runtime": core.runtime.name,
        "robot_mode": core.mode.name,
        "remote": core.remote,
        "program": core.program_name,
        "speed_slider": arm.slider,
        "outputs": core.io.outputs,
        "inputs": core.io.inputs,
        "moves_started": arm.moves_started,
        "moves_finished": arm.moves_finished,
        "stops": core.counts["stops"],
        "commands": core.counts["commands"],
        "distance_m": arm.distance_m,
        "counts": counts,
        "events": events,
    }


class Faults:
    """Requests of the fault port, carried out between two steps of the controller."""

    def __init__(self, core: Core, ports: Ports, owners: Owners, whole: Whole) -> None:
        self._core, self._ports, self._owners, self._whole = core, ports, owners, whole
        self._orders: dict[str, Act] = {
            "kill_program": lambda: core.stop_program("killed by a fault"),
            "protective_stop": lambda: core.protective_stop("fault port"),
            "safeguard": core.safeguard_stop,
            "emergency_stop": core.emergency_stop,
            "reduced": core.reduce,
            "violation": self._violation,
            "power_off": core.power_off,
        }
        self._doings: dict[str, Callable[[Request], Act]] = {
            "cut": self._cut,
            "refuse": self._refuse,
            "accept": self._accept,
            "freeze": lambda request: self._freeze(request, True),
            "thaw": lambda request: self._freeze(request, False),
            "half_frame": self._half_frame,
            "delay": lambda request: self._slow_wire(request, "delay_s"),
            "jitter": lambda request: self._slow_wire(request, "jitter_s"),
            "pieces": self._pieces,
            "message": self._message,
            "script": self._script,
            "release": self._release,
            "registers": self._registers,
            "hide": self._hide,
            "slow": self._slow,
            "speed_slider": self._slider,
            "remote": self._remote,
            "version": self._version,
            "payload": self._payload,
            "inputs": self._inputs,
        }

    @property
    def doings(self) -> tuple[str, ...]:
        """What can be asked for."""
        return ("status", *sorted((*self._orders, *self._doings)))

    def talk(self, connection: Connection) -> FaultTalk:  # noqa: ARG002 - as every port's
        """What a client of the fault port meets."""
        return FaultTalk(self)

    def answer(self, line: bytes) -> dict[str, Json]:
        """One request to one answer; refusals are answers too."""
        try:
            request = Request.of(line)
            doing = request.text("do", *self.doings)
            if doing == "status":
                return {"ok": True, **status_values(self._core), **self._wires()}
            act = self._orders.get(doing) or self._doings[doing](request)
            if request.has("at"):
                self._core.armed.append(self._armed(act, request.part("at")))
            else:
                act()
        except Refused as error:
            return {"error": str(error)}
        except OSError as error:
            return {"error": f"{doing}: {error.strerror}"}
        return {"ok": True}

    def _armed(self, act: Act, at: Request) -> Armed:
        if at.has("moving_s"):
            return Armed(act, moving_s=at.number("moving_s", 0.0, 3600.0))
        return Armed(act, at_s=self._core.time_s + at.number("after_s", 0.0, 3600.0))

    def _wires(self) -> dict[str, Json]:
        ports: dict[str, Json] = {}
        for port in self._ports.by_name.values():
            ports[port.name] = sum(each.port is port for each in self._ports.connections)
        return {
            "connections": ports,
            "owned_inputs": self._owners.owned(),
            "dropped_clients": self._ports.dropped,
            "armed": len(self._core.armed),
            "world": self._whole.world,
        }

    # ------------------------------------------------------------------ wires

    def _named(self, request: Request) -> list[Port]:
        """The ports of a request, by number or name."""
        found = []
        for each in request.items("ports"):
            port = [
                p for p in self._ports.by_name.values() if each in (p.name, p.number) and p.name != "fault"
            ]
            if not port:
                known = ", ".join(f"{p.number} ({p.name})" for p in self._ports.by_name.values())
                raise Refused(f"there is no port {each!r}; there are {known}")
            found.append(port[0])
        return found

    def _cut(self, request: Request) -> Act:
        ports = self._named(request)
        how: How = "rst" if not request.has("how") or request.text("how", "rst", "fin") == "rst" else "fin"

        def act() -> None:
            for port in ports:
                self._core.counts["cut"] += self._ports.cut(port, how)

        return act

    def _refuse(self, request: Request) -> Act:
        ports = self._named(request)

        def act() -> None:
            for port in ports:
                self._ports.refuse(port)

        return act

    def _accept(self, request: Request) -> Act:
        ports = self._named(request)

        def act() -> None:
            for port in ports:
                self._ports.accept(port)

        return act

    def _freeze(self, request: Request, frozen: bool) -> Act:
        what = request.text("what", "rtde", "dashboard", "script", "all", "clock")

        def act() -> None:
            if what == "clock":
                self._whole.standing = frozen
                return
            for port in self._ports.by_name.values():
                if port.name != "fault" and what in (port.name, "all"):
                    self._ports.freeze(port, frozen)

        return act

    def _half_frame(self, request: Request) -> Act:
        then = request.text("then", "stall", "close") if request.has("then") else "stall"

        def act() -> None:
            for connection in self._ports.connections:
                if connection.port.name == "rtde":
                    connection.halved = then

        return act

    def _slow_wire(self, request: Request, attribute: str) -> Act:
        what = request.text("what", "rtde", "dashboard") if request.has("what") else "rtde"
        seconds = request.number("s", 0.0, 600.0)
        return lambda: setattr(self._ports.by_name[what], attribute, seconds)

    def _pieces(self, request: Request) -> Act:
        size = int(request.number("bytes", 0, 65536))

        def act() -> None:
            self._ports.by_name["rtde"].piece = size or None

        return act

    def _message(self, request: Request) -> Act:
        text = request.text("text")
        level = Level(int(request.number("level", 0, 3)) if request.has("level") else 2)

        def act() -> None:
            for connection in tuple(self._ports.connections):
                if connection.port.name == "rtde":
                    connection.put(text_message(text, "fault port", level), 0.0)

        return act

    # ------------------------------------------------------------------ controller

    def _script(self, request: Request) -> Act:
        how = request.text("how", "normal", "ignore", "die")

        def act() -> None:
            self._core.script_fault = how

        return act

    def _violation(self) -> None:
        self._core.stop_program("safety violation")
        self._core.safety = Safety.VIOLATION

    def _release(self, request: Request) -> Act:
        resume = request.has("resume") and request.flag("resume")

        def act() -> None:
            self._core.release(resume)

        return act

    def _registers(self, request: Request) -> Act:
        taken = request.text("taken", "lower", "upper", "none")
        numbers = {"lower": range(24), "upper": range(24, REGISTERS), "none": range(0)}[taken]
        names = [f"input_{kind}_register_{n}" for kind in ("int", "double") for n in numbers]

        def act() -> None:
            self._owners.taken = frozenset(names)

        return act

    def _hide(self, request: Request) -> Act:
        names = frozenset(str(each) for each in request.items("names"))

        def act() -> None:
            self._owners.hidden = names

        return act

    def _slow(self, request: Request) -> Act:
        factor = request.number("factor", 0.0, 1.0)

        def act() -> None:
            self._core.arm.slow = factor

        return act

    def _slider(self, request: Request) -> Act:
        fraction = request.number("fraction", 0.0, 1.0)
        return lambda: self._core.set_slider(fraction)

    def _remote(self, request: Request) -> Act:
        on = request.flag("on")

        def act() -> None:
            self._core.remote = on

        return act

    def _version(self, request: Request) -> Act:
        parts = request.text("polyscope").split(".")
        if len(parts) != 3 or not all(part.isdecimal() for part in parts):
            raise Refused("'polyscope' must be a version such as 5.15.0")
        major, minor, bugfix = map(int, parts)

        def act() -> None:
            self._core.version = (major, minor, bugfix)

        return act

    def _payload(self, request: Request) -> Act:
        kg = request.number("kg", 0.0, 100.0)

        def act() -> None:
            self._core.payload_kg = kg

        return act

    def _inputs(self, request: Request) -> Act:
        bits = int(request.number("bits", 0, (1 << 18) - 1))

        def act() -> None:
            self._core.io.inputs = bits

        return act


class FaultTalk:
    """Lines of JSON."""

    greeting = b""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._rest = b""

    def received(self, data: bytes) -> Iterable[bytes] | None:
        """Answers to the whole lines."""
        *whole, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST_LINE:
            return None
        return [json.dumps(self._faults.answer(line)).encode() + b"\n" for line in whole if line.strip()]

    def closed(self) -> None:
        """Nothing to clear away."""
