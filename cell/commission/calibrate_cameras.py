"""``mikado calibrate cameras``: from views of a board to a calibration file, a plot, and plain words."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from cell import calibration, calibration_file
from cell.calibration_file import Json
from cell.commission.boardfile import BoardConfig
from cell.commission.camera_views import Collected, Refused
from cell.commission.coverage_plot import write_plot
from cell.errors import CalibrationError, UsageError
from vision.adjust import CannotCalibrate
from vision.boards import Board
from vision.calibrate import NAMES, Calibrated, View, ViewFit, calibrate
from vision.coverage import Coverage, coverage
from vision.types import Floats, StereoModel

MOST_RMS_PX: Final = 1.0
"""A calibration worse than this is not written: something is wrong, not merely inexact."""
_OUTLIER: Final = 3.0
_OUTLIER_PX: Final = 0.3
_APART_M: Final = 0.002
_BASELINE: Final = 0.03


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """What is to be done with the views; ``baseline_m`` is the distance of the lenses by a ruler."""

    out: Path
    plot: Path | None
    opencv: Path | None
    drop_worst: int
    baseline_m: float | None
    cameras: tuple[str, str] | None
    with_k3: bool = True


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """A calibration with all that is said of it."""

    calibrated: Calibrated
    views: tuple[View, ...]
    coverage: Coverage
    dropped: tuple[Refused, ...]
    doubts: tuple[str, ...]


def run(collected: Collected, board: BoardConfig, order: Order, console: Console) -> int:
    """Calibrate, say how well, write the files; exit code 0.

    Raises
    ------
    CalibrationError
        The views do not determine the cameras, or what they give cannot be right. Nothing is written.
    """
    _say_refused(collected.refused, console)
    outcome = solve(collected.views, board, order)
    _say_dropped(outcome.dropped, console)
    _say(outcome, console)
    for doubt in outcome.doubts:
        console.print(f"! {doubt}", markup=False)
    for words in outcome.coverage.missing:
        console.print(f"missing: {words}", markup=False)
    fields = document(outcome, board, collected.refused, order.cameras)
    calibration_file.write(order.out, fields)
    calibration.load(order.out)  # what was written must be what the cell can use
    written = [order.out]
    if order.opencv is not None:
        calibration_file.export_opencv(order.opencv, fields)
        written.append(order.opencv)
    if order.plot is not None:
        write_plot(order.plot, outcome.calibrated, outcome.views, outcome.coverage)
        written.append(order.plot)
    console.print(f"written: {', '.join(str(path) for path in written)}", markup=False)
    return 0


def solve(views: tuple[View, ...], config: BoardConfig, order: Order) -> Outcome:
    """Calibrate, dropping the worst views one by one where asked to."""
    board = config.board()
    kept = list(views)
    dropped: list[Refused] = []
    try:
        answer = calibrate(kept, board, with_k3=order.with_k3)
        for _ in range(order.drop_worst):
            worst = max(range(len(kept)), key=lambda k: _badness(answer.views[k]))
            fit = answer.views[worst]
            dropped.append(Refused(name=fit.name, why=f"dropped as the worst: {_of(fit)}"))
            del kept[worst]
            answer = calibrate(kept, board, with_k3=order.with_k3)
    except CannotCalibrate as error:
        raise CalibrationError(f"the cameras cannot be calibrated: {error}") from error
    _refuse(answer, order)
    covered = coverage_of(kept, answer, board)
    return Outcome(
        calibrated=answer,
        views=tuple(kept),
        coverage=covered,
        dropped=tuple(dropped),
        doubts=tuple(_doubts(answer, config, order)),
    )


def coverage_of(views: list[View], answer: Calibrated, board: Board) -> Coverage:
    """What the views cover, by the calibration they gave."""
    wide, high = board.size_m
    size = (answer.stereo.left.width_px, answer.stereo.left.height_px)
    return coverage(
        [view.left.pixels for view in views if view.left is not None],
        [view.right.pixels for view in views if view.right is not None],
        [fit.left_from_board for fit in answer.views],
        np.array([wide / 2, high / 2, 0.0]),
        size,
    )


def _badness(fit: ViewFit) -> float:
    return fit.worst_px


def _of(fit: ViewFit) -> str:
    return f"left {fit.left_px:.2f} px, right {fit.right_px:.2f} px, rows {fit.row_rms_px:.2f} px"


def _outliers(answer: Calibrated) -> list[ViewFit]:
    """Views that do not fit the others: much larger error, or another place of the right camera."""
    usual = float(np.median([fit.worst_px for fit in answer.views]))
    apart = np.array([fit.apart_m for fit in answer.views])
    spread = max(_APART_M, 6.0 * float(np.nanmedian(apart)))
    return [
        fit
        for fit in answer.views
        if fit.worst_px > max(_OUTLIER * usual, _OUTLIER_PX)
        or (np.isfinite(fit.apart_m) and fit.apart_m > spread)
    ]


def _refuse(answer: Calibrated, order: Order) -> None:
    """Raise `CalibrationError` for an answer that cannot be right."""
    rows = float(np.sqrt(np.mean(answer.rows_px**2)))
    worst = sorted(answer.views, key=lambda fit: -fit.worst_px)[:3]
    names = ", ".join(f"{fit.name} ({_of(fit)})" for fit in worst)
    if max(answer.stereo.rms_px, rows) > MOST_RMS_PX:
        raise CalibrationError(
            f"the views contradict each other: reprojection {answer.stereo.rms_px:.2f} px, rows {rows:.2f} "
            "px "
            f"(at most {MOST_RMS_PX:g}). Worst: {names}. Did board or cameras move between the two "
            "pictures of a "
            "view, is the board bent, or is it another one? Leave views out with --drop-worst N"
        )
    if order.baseline_m is not None:
        found = float(np.linalg.norm(answer.stereo.right_from_left.translation))
        if abs(found / order.baseline_m - 1.0) > _BASELINE:
            raise CalibrationError(
                f"the pitch of the board is wrong: by the views the lenses are {1e3 * found:.1f} mm apart, "
                "by the "
                f"ruler {1e3 * order.baseline_m:.1f} mm ({100 * (found / order.baseline_m - 1):+.1f} %); "
                "measure "
                "the printed bar and state it: mikado calibrate board --board FILE --measured-bar-mm"
            )


def _doubts(answer: Calibrated, config: BoardConfig, order: Order) -> list[str]:
    said = []
    for fit in _outliers(answer):
        said.append(
            f"view {fit.name} does not fit the others ({_of(fit)}; alone it would place the right camera "
            f"{1e3 * fit.apart_m:.1f} mm off): not the same moment, or not the same board? --drop-worst 1"
        )
    if not config.measured and order.baseline_m is None:
        said.append(
            "SCALE NOT CHECKED: nobody measured the printed bar. If the print is 1 % too large, every "
            "distance "
            "is 1 % wrong and no figure here shows it: mikado calibrate board --board FILE --measured-bar-mm"
        )
    for eye, camera in (("left", answer.stereo.left), ("right", answer.stereo.right)):
        fx, fy = camera.matrix[0, 0], camera.matrix[1, 1]
        if abs(fx / fy - 1.0) > 0.03:
            said.append(f"{eye}: focal lengths fx {fx:.0f} and fy {fy:.0f} px differ: are the pixels square?")
        off = np.abs(camera.matrix[:2, 2] / (camera.width_px, camera.height_px) - 0.5)
        if off.max() > 0.15:
            said.append(
                f"{eye}: the principal point ({camera.matrix[0, 2]:.0f}, {camera.matrix[1, 2]:.0f}) is far "
                "from "
                "the middle of the picture: too few tilted views, or a picture that was cut out of a "
                "larger one"
            )
    return said


# ------------------------------------------------------------------------------ saying


def _say_refused(refused: tuple[Refused, ...], console: Console) -> None:
    for one in refused:
        console.print(f"not used: {one.name}: {one.why}", markup=False)


def _say_dropped(dropped: tuple[Refused, ...], console: Console) -> None:
    for one in dropped:
        console.print(f"dropped: {one.name}: {one.why}", markup=False)


def _say(outcome: Outcome, console: Console) -> None:
    answer = outcome.calibrated
    table = Table(
        "view", "left px", "right px", "rows px", "tilt °", "distance mm", title="views, worst first"
    )
    order = sorted(range(len(answer.views)), key=lambda k: -answer.views[k].worst_px)
    for k in order:
        fit = answer.views[k]
        table.add_row(
            fit.name,
            *(
                f"{value:.3f}" if np.isfinite(value) else "-"
                for value in (fit.left_px, fit.right_px, fit.row_rms_px)
            ),
            f"{np.rad2deg(outcome.coverage.tilt_rad[k]):.0f}",
            f"{1e3 * outcome.coverage.distance_m[k]:.0f}",
        )
    console.print(table)
    cameras = Table("", "left", "±", "right", "±", title="cameras, ± one standard deviation")
    left, right = _numbers(answer, "left"), _numbers(answer, "right")
    for k, name in enumerate(NAMES):
        digits = 2 if k < 4 else 5
        cameras.add_row(
            name,
            f"{left[k]:.{digits}f}",
            f"{answer.left_sigma[k]:.{digits}f}",
            f"{right[k]:.{digits}f}",
            f"{answer.right_sigma[k]:.{digits}f}",
        )
    console.print(cameras)
    shift = 1e3 * answer.stereo.right_from_left.translation
    sigma = 1e3 * answer.shift_sigma_m
    turn = np.rad2deg(answer.turn_sigma_rad)
    rows = answer.rows_px
    console.print(
        f"right from left: {shift[0]:.3f} ± {sigma[0]:.3f}, {shift[1]:.3f} ± {sigma[1]:.3f}, "
        f"{shift[2]:.3f} ± "
        f"{sigma[2]:.3f} mm, turn ± {turn.max():.4f}°; baseline {np.linalg.norm(shift):.3f} mm\n"
        f"reprojection rms: left {answer.left_rms_px:.3f}, right {answer.right_rms_px:.3f}, both "
        f"{answer.stereo.rms_px:.3f} px; epipolar (rows after rectification): mean "
        f"{np.abs(rows).mean():.3f}, "
        f"95 % {np.percentile(np.abs(rows), 95):.3f} px",
        markup=False,
    )
    for eye, grid in (("left", outcome.coverage.left), ("right", outcome.coverage.right)):
        lines = " | ".join(" ".join(f"{count:4d}" for count in row) for row in grid)
        console.print(f"corners in the ninths of the {eye} picture: {lines}", markup=False)


def _numbers(answer: Calibrated, eye: str) -> list[float]:
    camera = answer.stereo.left if eye == "left" else answer.stereo.right
    m = camera.matrix
    return [float(v) for v in (m[0, 0], m[1, 1], m[0, 2], m[1, 2], *camera.distortion)]


# ------------------------------------------------------------------------------ writing


def document(
    outcome: Outcome, config: BoardConfig, refused: tuple[Refused, ...], cameras: tuple[str, str] | None
) -> dict[str, Json]:
    """The calibration file: geometry in metres, and how it came about."""
    answer, stereo = outcome.calibrated, outcome.calibrated.stereo
    rows = np.abs(answer.rows_px)
    fields: dict[str, Json] = {
        **_geometry(stereo),
        "rms_px": stereo.rms_px,
        "rms_left_px": answer.left_rms_px,
        "rms_right_px": answer.right_rms_px,
        "epipolar_px": {"mean": float(rows.mean()), "p95": float(np.percentile(rows, 95))},
        "sigma": {
            "names": list(NAMES),
            "left": answer.left_sigma.tolist(),
            "right": answer.right_sigma.tolist(),
            "turn_rad": answer.turn_sigma_rad.tolist(),
            "shift_m": answer.shift_sigma_m.tolist(),
        },
        "board": config.model_dump(mode="json", exclude_none=True),
        "scale_checked": config.measured,
        "views": [
            {
                "name": fit.name,
                "left_px": _or_none(fit.left_px),
                "right_px": _or_none(fit.right_px),
                "rows_px": _or_none(fit.row_rms_px),
            }
            for fit in answer.views
        ],
        "refused": [{"name": one.name, "why": one.why} for one in (*refused, *outcome.dropped)],
        "missing": list(outcome.coverage.missing),
        "doubts": list(outcome.doubts),
    }
    if cameras is not None:
        fields["cameras"] = {"left": cameras[0], "right": cameras[1]}
    return fields


def _geometry(stereo: StereoModel) -> dict[str, Json]:
    """What every calibration file says, in metres."""
    return {
        "version": 1,
        "units": "m",
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "image_width": stereo.left.width_px,
        "image_height": stereo.left.height_px,
        "K1": stereo.left.matrix.tolist(),
        "D1": stereo.left.distortion.tolist(),
        "K2": stereo.right.matrix.tolist(),
        "D2": stereo.right.distortion.tolist(),
        "R": stereo.right_from_left.rotation.tolist(),
        "T": stereo.right_from_left.translation.tolist(),
    }


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def import_opencv(source: Path, out: Path, console: Console) -> int:
    """Any calibration `cell.calibration.load` reads, as Mikado's JSON in metres; exit code 0."""
    if out.suffix.lower() != ".json":
        raise UsageError(f"{out}: calibration files are JSON; let the name end in .json")
    known = calibration.load(source)
    stereo = known.stereo
    fields: dict[str, Json] = {
        **_geometry(stereo),
        "imported_from": source.name,
    }
    if np.isfinite(stereo.rms_px):
        fields["rms_px"] = stereo.rms_px
    if known.base_from_camera is not None:
        pose: Floats = np.eye(4)
        pose[:3, :3], pose[:3, 3] = known.base_from_camera.rotation, known.base_from_camera.translation
        fields["base_from_camera"] = pose.tolist()
    if known.table is not None:
        fields["table_normal"] = known.table.normal.tolist()
        fields["table_offset"] = known.table.offset_m
    if known.cameras is not None:
        fields["cameras"] = {"left": known.cameras[0], "right": known.cameras[1]}
    calibration_file.write(out, fields)
    console.print(f"{out}: from {source} (units {known.units})", markup=False)
    return 0


def export(source: Path, out: Path, console: Console) -> int:
    """A calibration as OpenCV's YAML; exit code 0."""
    calibration.load(source)
    fields = calibration_file.read(source)
    if "base_from_camera" in fields:
        fields["T_base_cam"] = fields["base_from_camera"]
    calibration_file.export_opencv(out, fields)
    console.print(f"{out}: from {source}", markup=False)
    return 0
