"""One look without motion: a picture pair in; overlay, candidates and every refusal with its number out."""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console

from cell import calibration, empty_tray, frames, wiring
from cell import config as configuration
from cell.calibration import Calibration
from cell.colours import in_colour
from cell.commission.sight import Sight
from cell.commission.told import document_of, table_of
from cell.config import CellConfig, PartConfig
from cell.errors import UsageError
from cell.missed import MissedParts
from cell.mounting import Mounting, View, grab_from_arm
from cell.moved import refuse_moved
from cell.pictures import PictureCheck, refuse_flawed
from cell.planning import Plan, plan_picks
from cell.reaching import reach_of
from cell.stopwatch import StageTimes
from drivers.factory import Factory
from drivers.interfaces import Robot, StereoRig
from drivers.timing import Clock, MonotonicClock
from drivers.types import FramePair, JointAngles, Pixels
from vision.draw import draw
from vision.locate import locate
from vision.transforms import identity
from vision.types import Scene, Tuning


def from_files(
    left: Path,
    right: Path,
    calibration_path: Path,
    part_path: Path,
    tuning: Tuning,
    among_paths: tuple[Path, ...] = (),
) -> Sight:
    """A look at two picture files; ``among_paths`` are products that may lie there besides.

    Raises
    ------
    UsageError
        A file that is no picture, sizes that differ, no way to know the depth, a part too long to be seen,
        products with one code or that nothing tells apart, several for the published method.
    ConfigError, CalibrationError
        The product or calibration file cannot be used, or belongs to another picture size.
    PictureUnusable
        Black, saturated, flat.
    """
    paths = (part_path, *among_paths)
    parts = tuple(configuration.load_part(path) for path in paths)
    _refuse_alike(parts, paths, tuning)
    known = calibration.load(calibration_path)
    pixels = [_picture(path) for path in (left, right)]
    sizes = [(p.shape[1], p.shape[0]) for p in pixels]
    if sizes[0] != sizes[1]:
        raise UsageError(
            f"pictures differ in size: {left} is {sizes[0][0]}x{sizes[0][1]} px, "
            f"{right} is {sizes[1][0]}x{sizes[1][1]} px; give the two pictures of one pair"
        )
    calibration.fit(known, *sizes[0], f"{left} and {right}")
    for name, picture in ((left, pixels[0]), (right, pixels[1])):
        refuse_flawed(_grey(picture), str(name))
    if np.array_equal(pixels[0], pixels[1]):
        raise UsageError(f"{left} and {right} hold the same picture; give the left and the right one")
    if tuning.depth_m is None and known.table is None:
        raise UsageError(
            f"{calibration_path} does not say where the table is; give the distance of the parts from the "
            "left camera with --depth-m MIN MAX (metres)"
        )
    depth = tuning.depth_m
    if depth is None and known.table is not None:
        depth = calibration.depth_bounds_m(known, known.table, tuning.height_m)
    for part in parts:
        _refuse_too_long(part, known, depth)
        _refuse_colour(part, pixels[0], str(left), tuning)
    return Sight(
        left=pixels[0],
        right=pixels[1],
        left_name=str(left),
        right_name=str(right),
        known=known,
        part=parts[0],
        tuning=tuning,
        table=known.table,
        config=None,
        base_from_camera=known.base_from_camera,
        among=parts[1:],
    )


def from_cameras(config_path: Path, part_code: int | None, method: str | None) -> Sight:
    """A look through the configured cameras; nothing moves. The arm is asked where it stands if it carries
    them, and left alone otherwise.

    Raises
    ------
    ConfigError, CalibrationError, UsageError, DriverError, PictureUnusable
    """
    config = configuration.load(config_path)
    known = wiring.check(config, str(config_path))
    part = config.parts[0] if part_code is None else config.part(part_code)
    if part is None:
        codes = ", ".join(str(p.code) for p in config.parts)
        raise UsageError(f"{config_path} has no part with code {part_code}; it has {codes}")
    clock = MonotonicClock()
    factory, mounting = Factory(clock), wiring.mounting_of(config, known)
    rig = factory.rig(config.cameras.left, config.cameras.right, config.cameras.max_skew_s)
    robot = factory.robot("robot", config.robot) if mounting.on_arm else None
    check = PictureCheck()
    with ExitStack() as opened:
        for device in (rig,) if robot is None else (rig, robot):
            device.open()
            opened.callback(device.close)
        # twice, because only the second can show that a camera is frozen
        for _ in range(2):
            pair, view = _taken(config, mounting, rig, robot, clock)
            greys = check.check(pair)
    names = f"{pair.left.camera}, {pair.right.camera}"
    refuse_moved(mounting.standing(view).row_residual(*greys), names)
    tuning = empty_tray.tuning_of(config)
    if method is not None:
        tuning = replace(tuning, method="published" if method == "published" else "default")
    among = config.among(part)
    if among and tuning.method == "published":
        raise UsageError(f"part {part.code} lies among others; the published method knows one product a look")
    for one in (part, *among):
        _refuse_colour(one, pair.left.pixels, pair.left.camera, tuning)
    return Sight(
        left=pair.left.pixels,
        right=pair.right.pixels,
        left_name=pair.left.camera,
        right_name=pair.right.camera,
        known=known,
        part=part,
        tuning=tuning,
        table=view.table,
        config=config,
        base_from_camera=view.base_from_camera,
        among=among,
    )


def _taken(
    config: CellConfig, mounting: Mounting, rig: StereoRig, robot: Robot | None, clock: Clock
) -> tuple[FramePair, View]:
    newer_than, timeout_s = clock.now(), config.cameras.look_timeout_s
    if robot is None:
        pair = rig.grab_pair(newer_than=newer_than, timeout_s=timeout_s)
        return pair, mounting.view(identity())
    pair, tool = grab_from_arm(rig, robot, newer_than, timeout_s, clock)
    return pair, mounting.view(tool)


def look(sight: Sight, out: Path, console: Console) -> int:
    """Find, draw, write ``overlay.png`` and ``look.json`` into ``out``, print a table; exit code 0.

    In the table ± is one standard deviation, "under" the order of whatever lies over a part.
    """
    times = StageTimes(MonotonicClock())
    scene = locate(
        _grey(sight.left),
        _grey(sight.right),
        sight.known.stereo,
        sight.part.model(),
        sight.part.tuned(sight.tuning),
        sight.table,
        observe=times,
        colour_left=in_colour(sight.left) if any(part.colour is not None for part in sight.parts) else None,
        among=tuple(part.model() for part in sight.among),
    )
    plans = _plans(sight, scene)
    among = tuple(part.model() for part in sight.among)
    overlay = draw(sight.left, scene, sight.known.stereo, sight.part.model(), among)
    try:
        out.mkdir(parents=True, exist_ok=True)
        done, encoded = cv2.imencode(".png", overlay)
        if not done:
            raise UsageError(f"{out / 'overlay.png'}: the picture could not be encoded")
        (out / "overlay.png").write_bytes(encoded.tobytes())
        document = document_of(sight, scene, plans, times)
        (out / "look.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{out}: cannot be written: {error.strerror}") from error
    console.print(table_of(sight, scene, plans))
    if scene.row_offset_px:
        console.print(
            f"the rows of the right picture are {scene.row_offset_px:+.2f} px off the calibration "
            "(corrected for this look): calibrate the cameras again",
            soft_wrap=True,
        )
    mine = [candidate for candidate in scene.candidates if candidate.part_code == sight.part.code]
    offered = sum(candidate.offered for candidate in mine)
    others = len(scene.candidates) - len(mine)
    console.print(
        f"{offered} offered, {len(mine) - offered} refused"
        f"{f', {others} of other products' if sight.among else ''}; "
        f"method {scene.method}; {out / 'overlay.png'}, {out / 'look.json'}",
        soft_wrap=True,
        markup=False,
    )
    return 0


# ------------------------------------------------------------------------------ parts of it


def _picture(path: Path) -> Pixels:
    if not path.is_file():
        raise UsageError(f"{path}: no such file")
    picture = cv2.imdecode(np.frombuffer(path.read_bytes() or b"\0", dtype=np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        raise UsageError(f"{path}: not a picture OpenCV can read (PNG, JPEG, BMP, TIFF ...)")
    return np.asarray(picture, dtype=np.uint8)


def _grey(pixels: Pixels) -> Pixels:
    if pixels.ndim == 2:
        return pixels
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _refuse_alike(parts: tuple[PartConfig, ...], paths: tuple[Path, ...], tuning: Tuning) -> None:
    """Raise `UsageError` for several products that cannot be looked for together."""
    if len(parts) > 1 and tuning.method == "published":
        raise UsageError("the published method knows one product a look; give one --product FILE")
    for (one, here), (other, there) in combinations(zip(parts, paths, strict=True), 2):
        if one.code == other.code:
            raise UsageError(f"{here} and {there} have the same code {one.code}; give each product its own")
        if not one.apart_from(other):
            raise UsageError(
                f"{here} and {there}: nothing tells {one.name} from {other.name}; their lengths, diameters "
                "or colours must differ"
            )


def _refuse_too_long(part: PartConfig, known: Calibration, depth: tuple[float, float] | None) -> None:
    if depth is None:
        return
    seen = calibration.widest_view_m(known.stereo, depth[1])
    if part.length_m > seen:
        raise UsageError(
            f"part {part.name}: length_m {part.length_m:.3f} is longer than the field of view "
            f"({seen:.3f} m along the diagonal at {depth[1]:.3f} m); correct length_m or the depth"
        )


def _refuse_colour(part: PartConfig, left: Pixels, left_name: str, tuning: Tuning) -> None:
    """Raise `UsageError` where the part is told by its colour and colour cannot be told."""
    if part.colour is None:
        return
    if tuning.method == "published":
        raise UsageError(
            f"part {part.name}: the published method does not look at colour; leave out --method"
        )
    if in_colour(left) is None:
        raise UsageError(
            f"{left_name}: the picture is grey, but part {part.name} is told by its colour; give a picture "
            "in colour or leave out the part's colour"
        )


def _plans(sight: Sight, scene: Scene) -> dict[int, Plan]:
    """Plans by the identity of their candidate, where the robot's place is known from a configuration."""
    if sight.config is None:
        return {}
    base = sight.base_from_camera
    assert base is not None, "a configuration's cameras are somewhere"
    watch = JointAngles(q_rad=sight.config.workspace.watch_q_rad)
    kinematics = Factory(MonotonicClock()).kinematics(sight.config.robot)
    plans = plan_picks(
        scene,
        base,
        sight.config.workspace,
        sight.config.jaws,
        sight.part.diameter_m,
        frames.transform_of(frames.tool_down(np.zeros(3), 0.0)),
        MissedParts(),
        reach_of(kinematics, watch),
        sight.part.code,
        max(part.diameter_m for part in sight.parts),
        sight.part.grasp,
    )
    return {id(plan.candidate): plan for plan in plans}
