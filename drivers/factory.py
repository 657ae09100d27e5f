"""Settings to devices. A vendor library is loaded only in the branch that needs it."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from drivers.camera_settings import (
    CameraSettings,
    GigeCameraSettings,
    ReplayCameraSettings,
    SimCameraSettings,
    V4l2CameraSettings,
    runs_freely,
)
from drivers.errors import DeviceUnavailable
from drivers.interfaces import (
    Camera,
    CellServer,
    DigitalIo,
    Gripper,
    Kinematics,
    Plc,
    Robot,
    StereoRig,
    WatchedArm,
)
from drivers.settings import (
    GripperSettings,
    ModbusPlcSettings,
    ModbusServerPlcSettings,
    PlcSettings,
    RobotIoGripperSettings,
    RobotiqGripperSettings,
    RobotSettings,
    SimGripperSettings,
    SimRobotSettings,
    UrRobotSettings,
)
from drivers.timing import Clock
from drivers.types import Check, FoundCamera

if TYPE_CHECKING:
    from drivers.camera.life import Bell
    from drivers.camera.source import Source


class Factory:
    """Makes devices, unopened, all with one clock."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock

    def camera(self, name: str, settings: CameraSettings, bell: Bell | None = None) -> Camera:
        """A camera called ``name``; ``bell`` is shared by cameras that expose together on our word."""
        match settings:
            case SimCameraSettings():
                from drivers.sim.devices import SimCamera

                return SimCamera(name, settings, self.clock)
            case ReplayCameraSettings():
                from drivers.camera.replay import ReplayCamera

                return ReplayCamera(name, settings, self.clock)
            case V4l2CameraSettings():
                from drivers.camera.life import Life, OwnedCamera

                life = Life(period_s=1.0 / settings.rate_hz, lost_s=settings.lost_s)
                return OwnedCamera(self._webcam(name, settings), life, self.clock)
            case GigeCameraSettings():
                from drivers.camera.gige import GigeSource
                from drivers.camera.life import Life, OwnedCamera

                source = GigeSource(name, settings, self.clock)
                life = Life(
                    period_s=1.0 / settings.rate_hz,
                    lost_s=settings.lost_s,
                    idle_s=min(settings.lost_s / 2.0, 3.0),  # an unanswered heartbeat shows at a word
                    good_frames=10,  # the camera's clock is known by the quickest of some frames
                )
                trigger = source.trigger if settings.trigger == "software" else None
                return OwnedCamera(source, life, self.clock, trigger, bell)
            case _:
                assert_never(settings)

    def _webcam(self, name: str, settings: V4l2CameraSettings) -> Source:
        match settings.capture:
            case "ioctl":
                from drivers.camera.v4l2 import V4l2Source

                return V4l2Source(name, settings, self.clock)
            case "opencv":
                from drivers.camera.opencv import OpencvSource

                return OpencvSource(name, settings, self.clock)
            case _:
                assert_never(settings.capture)

    def camera_checks(self, left: CameraSettings, right: CameraSettings) -> tuple[Check, ...]:
        """What a look at what the cameras need on this machine shows; opens no camera."""
        wanted = tuple(one for one in (left, right) if isinstance(one, GigeCameraSettings))
        if not wanted:
            return ()
        from drivers.camera.gige_checks import checks

        return checks(wanted)

    def cameras_found(self) -> tuple[tuple[FoundCamera, ...], tuple[str, ...]]:
        """The cameras that can be seen from here, configured or not, those of each kind by name; and which
        kinds were not looked for, with what to install."""
        from drivers.camera import gige_list, v4l2_list

        webcams = v4l2_list.found()
        try:
            return (*webcams, *gige_list.found()), ()
        except DeviceUnavailable as error:
            return webcams, (f"GigE Vision cameras were not looked for. {error.detail}",)

    def rig(self, left: CameraSettings, right: CameraSettings, max_skew_s: float) -> StereoRig:
        """Two cameras, ``camera.left`` and ``camera.right``, as a rig."""
        from drivers.camera.life import Bell
        from drivers.camera.pair import TwoCameraRig

        bell = Bell()
        return TwoCameraRig(
            self.camera("camera.left", left, bell),
            self.camera("camera.right", right, bell),
            max_skew_s,
            self.clock,
            free_running=runs_freely(left) or runs_freely(right),
        )

    def robot(self, name: str, settings: RobotSettings) -> Robot:
        """An arm called ``name``."""
        match settings:
            case SimRobotSettings():
                from drivers.sim.robot import SimRobot

                return SimRobot(name, settings, self.clock)
            case UrRobotSettings():
                from drivers.robot.ur import UrRobot

                return UrRobot(name, settings, self.clock)
            case _:
                assert_never(settings)

    def watched_arm(self, name: str, settings: RobotSettings) -> WatchedArm:
        """An arm called ``name`` that a person leads."""
        match settings:
            case SimRobotSettings():
                from drivers.sim.robot import SimWatch

                return SimWatch(name, settings, self.clock)
            case UrRobotSettings():
                from drivers.robot.ur_watch import UrWatch

                return UrWatch(name, settings, self.clock)
            case _:
                assert_never(settings)

    def kinematics(self, settings: RobotSettings) -> Kinematics:
        """What is known of an arm without asking it."""
        match settings:
            case SimRobotSettings():
                from drivers.sim.reach import AskTheArm

                return AskTheArm()
            case UrRobotSettings():
                from drivers.robot.ur_reach import UrKinematics

                return UrKinematics(settings)
            case _:
                assert_never(settings)

    def robot_checks(self, settings: RobotSettings) -> tuple[Check, ...]:
        """What a look at the arm's controller shows; moves nothing and changes nothing."""
        match settings:
            case SimRobotSettings():
                return ()
            case UrRobotSettings():
                from drivers.robot.ur_preflight import checks

                return checks(settings, self.clock)
            case _:
                assert_never(settings)

    def gripper(self, name: str, settings: GripperSettings, io: DigitalIo) -> Gripper:
        """A gripper called ``name``; ``io`` is what it is wired to, where its settings say so."""
        match settings:
            case SimGripperSettings():
                from drivers.sim.devices import SimGripper

                return SimGripper(name, settings, self.clock)
            case RobotIoGripperSettings():
                from drivers.gripper.robot_io import RobotIoGripper

                return RobotIoGripper(name, settings, io, self.clock)
            case RobotiqGripperSettings():
                from drivers.gripper.robotiq import RobotiqGripper

                return RobotiqGripper(name, settings, self.clock)
            case _:
                assert_never(settings)

    def gripper_checks(self, settings: GripperSettings, robot: RobotSettings) -> tuple[Check, ...]:
        """What a look at the gripper shows, at the arm's pins where it is wired to these; moves nothing.

        Raises
        ------
        DriverError
            The arm's controller does not tell its pins.
        """
        match settings:
            case SimGripperSettings():
                return ()
            case RobotIoGripperSettings():
                from drivers.gripper import robot_io

                match robot:
                    case SimRobotSettings():
                        return ()
                    case UrRobotSettings():
                        from drivers.robot.ur_pins import read_pins

                        return robot_io.checks(settings, read_pins("gripper", robot.host, self.clock))
                    case _:
                        assert_never(robot)
            case RobotiqGripperSettings():
                from drivers.gripper import robotiq

                return robotiq.checks(settings, self.clock)
            case _:
                assert_never(settings)

    def plc(self, name: str, settings: PlcSettings) -> Plc:
        """A PLC called ``name``."""
        match settings:
            case ModbusPlcSettings():
                from drivers.plc.modbus import ModbusPlc

                return ModbusPlc(name, settings, self.clock)
            case ModbusServerPlcSettings():
                from drivers.plc.server import ModbusServerPlc

                return ModbusServerPlc(name, settings, self.clock)
            case _:
                assert_never(settings)

    def cell_server(self, settings: ModbusServerPlcSettings) -> CellServer:
        """The registers of a daemon with these settings, from the PLC's side."""
        from drivers.sim.plc_client import CellRegisters

        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(settings.bind, settings.bind)
        return CellRegisters(host, settings.port, settings.word_order)
