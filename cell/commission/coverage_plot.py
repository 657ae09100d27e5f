"""A calibration as a picture: where corners were, how far off, tilts, views, rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cell.errors import UsageError
from vision.boards import Corners
from vision.calibrate import Calibrated, View
from vision.coverage import Coverage


def write_plot(path: Path, answer: Calibrated, views: tuple[View, ...], covered: Coverage) -> None:
    """Write the plot; the name's ending (.png, .pdf, .svg) says as what.

    Raises
    ------
    UsageError
        The file cannot be written.
    """
    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    axes = figure.subplots(2, 3)
    camera = answer.stereo.left
    size = (camera.width_px, camera.height_px)
    _corners(axes[0, 0], [view.left for view in views], size, "left picture")
    _corners(axes[0, 1], [view.right for view in views], size, "right picture")
    _tilts(axes[0, 2], covered)
    _views(axes[1, 0], answer)
    _rows(axes[1, 1], answer)
    _distances(axes[1, 2], covered)
    figure.suptitle(
        f"{len(views)} views, reprojection rms {answer.stereo.rms_px:.3f} px, "
        f"rows {np.abs(answer.rows_px).mean():.3f} px mean"
        + ("" if not covered.missing else f"; missing: {'; '.join(covered.missing[:2])}"),
        fontsize=10,
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=90)
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: cannot be written: {error}") from error


def _corners(axes: Axes, seen: list[Corners | None], size: tuple[int, int], title: str) -> None:
    """Corners of each view in a colour of its own, over the ninths that advice speaks of."""
    for corners in seen:
        if corners is not None:
            axes.plot(corners.pixels[:, 0], corners.pixels[:, 1], ".", markersize=2.5)
    for k in (1, 2):
        axes.axvline(size[0] * k / 3, color="0.8", linewidth=0.8)
        axes.axhline(size[1] * k / 3, color="0.8", linewidth=0.8)
    axes.set_xlim(0, size[0])
    axes.set_ylim(size[1], 0)
    axes.set_aspect("equal")
    axes.set_title(f"corners, {title}", fontsize=9)
    axes.tick_params(labelsize=7)


def _tilts(axes: Axes, covered: Coverage) -> None:
    leans = np.rad2deg(np.arcsin(np.clip(covered.leans, -1.0, 1.0)))
    for reach in (20, 40):
        turn = np.linspace(0, 2 * np.pi, 90)
        axes.plot(reach * np.cos(turn), reach * np.sin(turn), color="0.8", linewidth=0.8)
    axes.plot(leans[:, 0], leans[:, 1], "o", markersize=4)
    axes.set_xlim(-60, 60)
    axes.set_ylim(60, -60)
    axes.set_aspect("equal")
    axes.set_title("tilt of the board, degrees (circles: 20, 40)", fontsize=9)
    axes.set_xlabel("to the side", fontsize=8)
    axes.set_ylabel("up and down", fontsize=8)
    axes.tick_params(labelsize=7)


def _views(axes: Axes, answer: Calibrated) -> None:
    at = np.arange(len(answer.views))
    axes.bar(at - 0.2, [fit.left_px for fit in answer.views], width=0.4, label="left")
    axes.bar(at + 0.2, [fit.right_px for fit in answer.views], width=0.4, label="right")
    axes.axhline(answer.stereo.rms_px, color="0.4", linewidth=0.8)
    axes.set_xticks(at, [fit.name for fit in answer.views], rotation=90, fontsize=6)
    axes.set_title("error of each view, px", fontsize=9)
    axes.legend(fontsize=7)
    axes.tick_params(axis="y", labelsize=7)


def _rows(axes: Axes, answer: Calibrated) -> None:
    axes.hist(answer.rows_px, bins=41)
    axes.set_title("row difference of corners after rectification, px", fontsize=9)
    axes.tick_params(labelsize=7)


def _distances(axes: Axes, covered: Coverage) -> None:
    axes.plot(np.rad2deg(covered.tilt_rad), 1e3 * covered.distance_m, "o", markersize=4)
    axes.set_xlabel("tilt, degrees", fontsize=8)
    axes.set_ylabel("distance, mm", fontsize=8)
    axes.set_title("tilt and distance of each view", fontsize=9)
    axes.tick_params(labelsize=7)
