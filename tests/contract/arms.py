"""Arms behind the contract: those made here, and what they are asked to do."""

from __future__ import annotations

from drivers.robot.ur import UrRobot
from drivers.settings import SimRobotSettings
from drivers.sim.robot import SimRobot
from drivers.timing import MonotonicClock
from drivers.types import JointAngles, JointMotion, LineMotion, ToolPose
from tests.fakes.ur_controller import UrController

CLOCK = MonotonicClock()
HOME = JointAngles(q_rad=(2.14, -1.92, 1.91, -1.56, -1.5708, 3.71))
ELSEWHERE = JointAngles(q_rad=(1.9, -1.7, 1.8, -1.6, -1.5708, 3.71))
QUICK = JointMotion(speed_rad_s=2.0, accel_rad_s2=4.0, timeout_s=10.0)
LINE = LineMotion(speed_m_s=0.5, accel_m_s2=2.0, timeout_s=10.0)
CRAWL = LineMotion(speed_m_s=0.01, accel_m_s2=1.0, timeout_s=10.0)
FAR = ToolPose(x=2.0, y=0.0, z=0.3, rx=3.14159, ry=0.0, rz=0.0)


def ur(controller: UrController) -> UrRobot:
    return UrRobot("robot", controller.settings(), CLOCK)


def sim(port: int) -> SimRobot:
    return SimRobot("robot", SimRobotSettings(driver="sim", port=port), CLOCK)
