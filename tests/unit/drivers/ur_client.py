"""The client's side of the simulated UR controller, stepped by hand; no sockets."""

from __future__ import annotations

from collections.abc import Callable

from drivers.sim.ur_codes import Runtime
from drivers.sim.ur_core import Core
from drivers.sim.ur_kinematics import Six

SCRIPT = """def rtde_control():
    global reg_offset_float = # float register offset
{0}    global reg_offset_int = # int register offset
{0}    global force_mode_type = 2
        # inject move path
{1}
    end
end"""
HOME: Six = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
AWAY: Six = (0.5, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)


class Client:
    """The client's side of the register protocol, one 2 ms cycle at a time."""

    def __init__(self, core: Core, offset: int = 0, path: str = "") -> None:
        self.core, self.offset = core, offset
        self.path = path

    def upload(self) -> Client:
        self.core.upload(SCRIPT.format(self.offset, self.path))
        self.until(lambda: self.core.runtime is Runtime.PLAYING)
        return self

    def steps(self, count: int) -> None:
        for _ in range(count):
            self.core.step()

    def seconds(self, seconds: float) -> None:
        self.steps(round(seconds / 0.002))

    def until(self, condition: Callable[[], bool], within_s: float = 20.0) -> float:
        """Step until it is so; the simulated time that took."""
        began_s = self.core.time_s
        while not condition():
            self.core.step()
            assert self.core.time_s - began_s < within_s, self.core.events
        return self.core.time_s - began_s

    def order(self, command: int, doubles: tuple[float, ...] = (), asynchronous: bool = False) -> None:
        """Put a command into the registers, as one data package does."""
        core, at = self.core, self.offset
        core.input_doubles[at : at + len(doubles)] = doubles
        core.input_ints[at + 1] = int(asynchronous)
        core.input_ints[at] = command
        core.input_written(at)

    def done(self, command: int, doubles: tuple[float, ...] = (), asynchronous: bool = False) -> float:
        """Order and wait for DONE, then clear; the simulated time that took."""
        self.until(lambda: self.core.output_ints[self.offset] == 1)
        self.order(command, doubles, asynchronous)
        took_s = self.until(lambda: self.core.output_ints[self.offset] == 2)
        self.order(0)
        self.until(lambda: self.core.output_ints[self.offset] == 1)
        return took_s

    @property
    def status(self) -> tuple[int, bool, int]:
        """Operation id, running, progress."""
        word = self.core.output_ints[self.offset + 2]
        return word >> 24 & 0x7F, bool(word >> 15 & 1), word & 0x7FFF

    def doubles(self, count: int) -> list[float]:
        return self.core.output_doubles[self.offset : self.offset + count]
