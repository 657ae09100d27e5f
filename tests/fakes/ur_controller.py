"""The simulated UR controller as the driver's tests need it: started where the arm works, mended after a
fault, with settings of a driver for it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from drivers.settings import UrRobotSettings
from tests.fakes import urcontroller
from tests.fakes.urcontroller import PORTS, ROOT, Json, free_host

TCP = (0.0, 0.0, 0.165, 0.0, 0.0, 0.0)
START_Q = (2.14, -1.92, 1.91, -1.56, -1.5708, 3.71)


class UrController(urcontroller.UrController):
    """A running controller whose arm a driver moves."""

    def number(self, key: str) -> float:
        """One figure of the status."""
        return float(self.status()[key])

    @property
    def moving(self) -> bool:
        """Whether its arm moves, as the arm itself knows."""
        return self.status()["moving"] is True

    def mend(self) -> None:
        """Take every fault back; what the arm was stopped for is a person's to clear."""
        self.do("thaw", what="all")
        self.do("thaw", what="clock")
        self.do("accept", ports=list(PORTS))
        for wire in ("rtde", "dashboard"):
            self.do("delay", what=wire, s=0)
            self.do("jitter", what=wire, s=0)
        self.do("script", how="normal")
        self.do("registers", taken="none")
        self.do("slow", factor=1.0)
        self.do("speed_slider", fraction=1.0)
        self.do("remote", on=True)
        self.do("version", polyscope="5.15.0")

    def settings(self, **changes: object) -> UrRobotSettings:
        """Settings of a driver for it."""
        values: dict[str, object] = {
            "driver": "ur",
            "host": self.host,
            "model": "UR5e",
            "tcp_m_rad": TCP,
            "payload_kg": 0.9,
            "payload_cog_m": (0.0, 0.0, 0.05),
            "tool_from": "configuration",
            "tool_box_min_m": (-0.8, -0.8, 0.0),
            "tool_box_max_m": (0.8, 0.8, 0.9),
        }
        return UrRobotSettings.model_validate(values | changes)


@contextmanager
def ur_controller(*arguments: str) -> Iterator[UrController]:
    """A controller on an address of its own, its arm beside the tray; it has ended when the context ends."""
    start = ("--start-q=" + ",".join(map(str, START_Q)), "--tcp=" + ",".join(map(str, TCP)))
    with urcontroller.ur_controller(*start, *arguments) as running:
        controller = UrController(running.process, running.host, running.fault_port)
        try:
            yield controller
        finally:
            controller.close()


__all__ = ["ROOT", "START_Q", "TCP", "Json", "UrController", "free_host", "ur_controller"]
