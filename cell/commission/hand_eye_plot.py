"""A hand-eye session as a picture: where tool, camera and board were, and what each pose leaves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D

from cell.errors import UsageError
from vision import transforms
from vision.handeye import Sighting
from vision.handeye_checks import Verdict
from vision.types import Transform


def write_plot(path: Path, sightings: Sequence[Sighting], verdict: Verdict) -> None:
    """Write the picture. Raises `UsageError` when it cannot be written."""
    figure = Figure(figsize=(11.0, 5.5), layout="constrained")
    space = figure.add_subplot(1, 2, 1, projection="3d")
    assert isinstance(space, Axes3D)
    places = np.stack([s.base_from_tool.translation for s in sightings])
    size = 0.12 * max(0.1, float(np.ptp(places, axis=0).max()))
    for number, sighting in enumerate(sightings):
        good = number in verdict.used
        _axes(space, sighting.base_from_tool, size, 1.0 if good else 0.3)
        space.text(
            *sighting.base_from_tool.translation, sighting.name, fontsize=6, color="k" if good else "r"
        )
    if verdict.fit is not None:
        found = verdict.fit.found
        if verdict.mount == "fixed":
            _axes(space, found.mount_from_camera, 3 * size, 1.0)
            space.text(*found.mount_from_camera.translation, "left camera", fontsize=8)
        else:
            _axes(space, found.held_from_board, 3 * size, 1.0)
            space.text(*found.held_from_board.translation, "board", fontsize=8)
            for sighting in sightings:
                camera = transforms.compose(sighting.base_from_tool, found.mount_from_camera)
                _axes(space, camera, 0.5 * size, 0.5)
    space.set_xlabel("x, m", fontsize=8)
    space.set_ylabel("y, m", fontsize=8)
    space.set_zlabel("z, m", fontsize=8)
    space.set_aspect("equal")
    space.tick_params(labelsize=6)
    space.set_title("tool poses in the robot's base (red x, green y, blue z)", fontsize=9)
    bars = figure.add_subplot(1, 2, 2)
    names = [s.name for s in sightings]
    held = 1e3 * np.nan_to_num(verdict.held_out_m)
    colours = ["tab:blue" if k in verdict.used else "tab:red" for k in range(len(names))]
    bars.bar(range(len(names)), held, color=colours)
    bars.set_xticks(range(len(names)), names, fontsize=7, rotation=90)
    bars.set_ylabel("board off its place as the other poses have it, mm", fontsize=8)
    if held.size and held.max() > 20 * max(1e-9, float(np.median(held))):
        bars.set_yscale("log")
    bars.set_title("each pose left out once (red: not used)", fontsize=9)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=90)
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: cannot be written: {error}") from error


def _axes(space: Axes3D, pose: Transform, size: float, alpha: float) -> None:
    for axis, colour in enumerate(("tab:red", "tab:green", "tab:blue")):
        end = pose.translation + size * pose.rotation[:, axis]
        space.plot(*np.stack([pose.translation, end]).T, color=colour, linewidth=1.0, alpha=alpha)
