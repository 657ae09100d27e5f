"""The person who commissions the simulated cell: types commands, moves the board, measures with a rule that
knows the truth of the simulation."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from drivers.settings import SimRobotSettings
from drivers.sim.geometry import Floats, apply, pose_matrix
from drivers.sim.robot import SimRobot
from drivers.timing import MonotonicClock, StopToken
from drivers.types import JointAngles, JointMotion
from tests.fakes.simcell import ROOT, SimCell

DEMO = ROOT / "configs" / "demo"
BOARD = {
    "kind": "charuco", "columns": 9, "rows": 7, "pitch_m": 0.020, "marker_m": 0.015,
    "dictionary": "DICT_4X4_50",
}  # fmt: skip
PROMPT = "'skip'): "


@dataclass(frozen=True, slots=True, kw_only=True)
class Commissioner:
    """Works in a folder of its own."""

    folder: Path
    cell: SimCell
    start: Path = DEMO
    """The configuration to begin with."""

    def configure(self) -> None:
        """The demo's configuration with the cell's port, its world beside it, and nothing calibrated."""
        for name in ("world.yaml", "ur.yaml"):
            (self.folder / name).write_bytes((self.start / name).read_bytes())
        text = (self.start / "cell.yaml").read_text(encoding="utf-8")
        text = text.replace("port: 5100", f"port: {self.cell.port}")
        text = re.sub(r"look_timeout_s: [0-9.]+", "look_timeout_s: 60.0", text)
        (self.folder / "cell.yaml").write_text(text, encoding="utf-8")
        (self.folder / "board.yaml").write_text(yaml.safe_dump(BOARD), encoding="utf-8")

    def mikado(self, *words: str, timeout_s: float = 600.0) -> subprocess.CompletedProcess[str]:
        """Type a command; what it said and how it ended."""
        return subprocess.run(
            [sys.executable, "-m", "cell", *words],
            cwd=self.folder, capture_output=True, text=True, timeout=timeout_s, check=False,
            env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "OMP_NUM_THREADS": "1", "COLUMNS": "120"},
        )  # fmt: skip

    def touch(self, *words: str) -> tuple[int, str]:
        """`mikado verify touch`, answered with what a rule would say."""
        with subprocess.Popen(
            [
                sys.executable, "-m", "cell", "verify", "touch", "cell.yaml", "--board", "board.yaml",
                "--yes", *words,
            ],
            cwd=self.folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "COLUMNS": "120"},
        ) as process:  # fmt: skip
            assert process.stdin is not None
            assert process.stdout is not None
            said = ""
            while letter := process.stdout.read(1):
                said += letter
                if said.endswith(PROMPT):
                    number = int(said.rsplit("corner ", 1)[1].split(":")[0])
                    x, y, z = 1e3 * (self.corner(number) - self.tip())
                    process.stdin.write(f"{x:.4f} {y:.4f} {z:.4f}\n")
                    process.stdin.flush()
            return process.wait(30.0), said

    def lead(self, routine: Path, save: str) -> tuple[int, str]:
        """`calibrate hand-eye --free`: the arm is led through the poses of an earlier session."""
        way = [JointAngles(q_rad=tuple(pose["joints"])) for pose in json.loads(routine.read_text())["poses"]]
        clock = MonotonicClock()
        settings = SimRobotSettings(driver="sim", host="127.0.0.1", port=self.cell.port)
        hand, slowly = (
            SimRobot("hand", settings, clock),
            JointMotion(speed_rad_s=0.5, accel_rad_s2=1.0, timeout_s=60.0),
        )
        hand.open()
        try:
            hand.move_joints(way[0], slowly, StopToken(clock))
            with subprocess.Popen(
                [
                    sys.executable, "-u", "-m", "cell", "calibrate", "hand-eye", "--config", "cell.yaml",
                    "--board", "board.yaml", "--free", str(len(way)), "--save", save,
                ],
                cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "COLUMNS": "120"},
            ) as process:  # fmt: skip
                assert process.stdout is not None
                said = ""
                for line in process.stdout:
                    said += line
                    number = line[5:7]
                    if line.startswith("pose ") and ": kept" in line and int(number) < len(way):
                        hand.move_joints(way[int(number)], slowly, StopToken(clock))
                return process.wait(30.0), said
        finally:
            hand.close()

    def corner(self, number: int) -> Floats:
        """Where an inner corner of the board really is, base frame, m."""
        board = np.array(self.cell.ask("truth").values["base_from_board"], dtype=np.float64)
        row, column = divmod(number, 8)
        return apply(board, 0.020 * np.array([column + 1.0, row + 1.0, 0.0]))

    def tip(self) -> Floats:
        """Where the tip of the closed jaws really is."""
        tool = pose_matrix(self.cell.ask("state").six("tool"))
        beyond = yaml.safe_load((self.folder / "world.yaml").read_text())["gripper"]["tip_beyond_tool_m"]
        return apply(tool, np.array([0.0, 0.0, float(beyond)]))

    def camera_error_mm(self) -> Floats:
        """How far points of the pick area are off by the calibration found, against the world's own."""
        found = json.loads((self.folder / "calibration.json").read_text())
        true = json.loads((DEMO / "calibration.json").read_text())
        u, v = np.meshgrid(np.linspace(60, 580, 5), np.linspace(60, 420, 5))
        errors = []
        for pixel in np.stack([u.ravel(), v.ravel(), np.ones(25)], axis=1):
            places = []
            for known in (found, true):
                ray = np.linalg.inv(np.array(known["K1"])) @ pixel
                base = np.array(known["base_from_camera"])
                direction = base[:3, :3] @ ray
                places.append(base[:3, 3] + direction * ((0.02 - base[2, 3]) / direction[2]))
            errors.append(1e3 * float(np.linalg.norm(places[0] - places[1])))
        return np.array(errors)
