"""``mikado product grasp``: where a part is gripped, written into its product file, with a drawn preview."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import yaml
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from pydantic import ValidationError
from rich.console import Console

from cell import config as configuration
from cell.config import CellConfig
from cell.errors import UsageError
from cell.products import GraspConfig, PartConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What is to change, in metres; None leaves what the product file has."""

    from_middle_m: float | None
    slack_m: float | None
    approach_height_m: float | None
    retreat_height_m: float | None


def grasp(product: Path, config_path: Path, wish: Wish, preview: Path | None, console: Console) -> int:
    """Change the grasp of a product file and draw it; exit code 0.

    Raises
    ------
    UsageError
        A grasp the jaws of the configuration cannot do, or a file that cannot be written.
    ConfigError
        Product file or configuration cannot be used.
    """
    part = configuration.load_part(product)
    config = configuration.load(config_path)
    values = (part.grasp or GraspConfig()).model_dump()
    for key in values:
        if getattr(wish, key) is not None:
            values[key] = getattr(wish, key)
    try:
        part = PartConfig.model_validate(part.model_dump() | {"grasp": values})
    except ValidationError as error:
        raise UsageError(f"{product}: {error.errors()[0]['msg'].removeprefix('Value error, ')}") from error
    _refuse(part, config, config_path)
    text = "# Metres.\n" + yaml.safe_dump(part.model_dump(mode="json", exclude_none=True), sort_keys=False)
    try:
        product.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{product}: cannot be written: {error.strerror}") from error
    wanted = part.grasp or GraspConfig()
    console.print(
        f"{product}: gripped {1e3 * wanted.from_middle_m:g} mm from the middle, give or take "
        f"{1e3 * _slack_m(part, wanted):g} mm; from {1e3 * _approach_m(wanted, config):g} mm above, lifted "
        "by "
        f"{1e3 * _retreat_m(wanted, config):g} mm at least; the hand goes straight down",
        markup=False,
    )
    if preview is not None:
        draw(preview, part, config)
        console.print(f"preview: {preview}", markup=False)
    return 0


def _slack_m(part: PartConfig, wanted: GraspConfig) -> float:
    return 0.4 * part.length_m if wanted.slack_m is None else wanted.slack_m


def _approach_m(wanted: GraspConfig, config: CellConfig) -> float:
    return wanted.approach_height_m or config.workspace.approach_height_m


def _retreat_m(wanted: GraspConfig, config: CellConfig) -> float:
    return wanted.retreat_height_m or _approach_m(wanted, config)


def _refuse(part: PartConfig, config: CellConfig, config_path: Path) -> None:
    """Raise `UsageError` for what the jaws cannot do."""
    jaws = config.jaws
    if part.diameter_m >= jaws.opening_m:
        raise UsageError(
            f"the part is {1e3 * part.diameter_m:g} mm thick, the jaws of {config_path} open "
            f"{1e3 * jaws.opening_m:g} mm: other fingers, or jaws.opening_m is wrong"
        )
    wanted = part.grasp or GraspConfig()
    if wanted.from_middle_m + jaws.width_m / 2 > part.length_m / 2:
        raise UsageError(
            f"{1e3 * wanted.from_middle_m:g} mm from the middle the fingers ({1e3 * jaws.width_m:g} mm "
            "wide) reach "
            f"over the part's end; at most {1e3 * (part.length_m - jaws.width_m) / 2:g} mm"
        )


def draw(path: Path, part: PartConfig, config: CellConfig) -> None:
    """Write the preview: along the part, and across it. Raises `UsageError` when it cannot be written."""
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    along, across = figure.subplots(1, 2)
    _along(along, part, config)
    _across(across, part, config)
    figure.suptitle(f"grasp of {part.name}; millimetres above the floor", fontsize=10)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=90)
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: cannot be written: {error}") from error


def _heights_mm(part: PartConfig, config: CellConfig) -> tuple[float, float]:
    """Of a part on the floor: the tool centre point, and the finger tips."""
    jaws, space = config.jaws, config.workspace
    lowest = space.floor_clearance_m + jaws.tip_beyond_tool_m
    tool = max(part.diameter_m / 2 - jaws.below_axis_m, lowest)
    return 1e3 * tool, 1e3 * (tool - jaws.tip_beyond_tool_m)


def _along(axes: Axes, part: PartConfig, config: CellConfig) -> None:
    """The part from the side, a finger before it."""
    wanted, jaws = part.grasp or GraspConfig(), config.jaws
    long, thick = 1e3 * part.length_m, 1e3 * part.diameter_m
    tool, tips = _heights_mm(part, config)
    approach, retreat = 1e3 * _approach_m(wanted, config), 1e3 * _retreat_m(wanted, config)
    axes.add_patch(Rectangle((-long / 2, 0), long, thick, facecolor="tan", edgecolor="0.3"))
    slack = min(1e3 * _slack_m(part, wanted), long / 2)
    for side in (1, -1) if wanted.from_middle_m > 0 else (1,):
        at = side * 1e3 * wanted.from_middle_m
        low, high = max(at - slack, -long / 2), min(at + slack, long / 2)
        axes.plot([low, high], [-4, -4], color="tab:green", linewidth=3, alpha=0.5)
        wide, deep = 1e3 * jaws.width_m, 1e3 * jaws.depth_m
        axes.add_patch(
            Rectangle(
                (at - wide / 2, tips),
                wide,
                deep,
                facecolor="tab:blue",
                edgecolor="0.2",
                alpha=0.55 if side == 1 else 0.2,
            )
        )
        if side == 1:
            axes.plot([at], [tool], "r+", markersize=10)
            for words, x, low_to_high in (
                ("approach", at, (tool + approach, tool)),
                ("retreat", at + wide / 2 + 6, (tool, tool + retreat)),
            ):
                axes.annotate(
                    "",
                    (x, low_to_high[1]),
                    (x, low_to_high[0]),
                    arrowprops={"arrowstyle": "->", "color": "tab:red"},
                )
                axes.text(x, max(low_to_high) + 2, words, ha="center", fontsize=8)
    _frame(axes, long / 2 + 15, tool + max(approach, retreat) + 12)
    axes.set_title("along the part (green: where the jaws may go)", fontsize=9)


def _across(axes: Axes, part: PartConfig, config: CellConfig) -> None:
    """The end of the part between the open jaws."""
    jaws = config.jaws
    _, tips = _heights_mm(part, config)
    half, thick = 1e3 * jaws.opening_m / 2, 1e3 * jaws.thickness_m
    for left in (-half - thick, half):
        axes.add_patch(
            Rectangle(
                (left, tips), thick, 1e3 * jaws.depth_m, facecolor="tab:blue", edgecolor="0.2", alpha=0.55
            )
        )
    axes.add_patch(
        Circle((0, 500 * part.diameter_m), 500 * part.diameter_m, facecolor="tan", edgecolor="0.3")
    )
    axes.annotate("", (-half, 0.8 * 1e3 * jaws.depth_m), (half, 0.8 * 1e3 * jaws.depth_m),
                  arrowprops={"arrowstyle": "<->"})  # fmt: skip
    axes.text(0, 0.83 * 1e3 * jaws.depth_m, f"opens {2 * half:g} mm", ha="center", fontsize=8)
    _frame(axes, half + thick + 15, 1e3 * jaws.depth_m + 12)
    axes.set_title(f"across it; tips {tips:.1f} mm above the floor", fontsize=9)


def _frame(axes: Axes, side_mm: float, top_mm: float) -> None:
    axes.axhline(0, color="0.2", linewidth=1.2)
    axes.set_xlim(-side_mm, side_mm)
    axes.set_ylim(-8, top_mm)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
