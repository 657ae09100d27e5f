"""``mikado product grasp``: where a part is gripped, written into its product file, with a drawn preview."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.transforms import Affine2D
from pydantic import ValidationError
from rich.console import Console

from cell import config as configuration
from cell.commission import changed
from cell.config import CellConfig, JawsConfig
from cell.errors import UsageError
from cell.products import GraspConfig, PartConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What is to change, in metres; None leaves what the product file has."""

    from_middle_m: float | None
    slack_m: float | None
    approach_height_m: float | None
    retreat_height_m: float | None
    free_rotation_rad: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Fingers:
    """What is to change of the configuration's ``jaws``, in metres; None leaves what it has."""

    opening_m: float | None = None
    width_m: float | None = None
    thickness_m: float | None = None
    depth_m: float | None = None
    min_clearance_m: float | None = None
    tip_beyond_tool_m: float | None = None
    below_axis_m: float | None = None


def grasp(
    product: Path, config_path: Path, wish: Wish, fingers: Fingers, preview: Path | None, console: Console
) -> int:
    """Change the grasp of a product file, and the jaws of the configuration, and draw both; exit code 0.

    Raises
    ------
    UsageError
        A grasp the jaws cannot do, or a file that cannot be written.
    ConfigError
        Product file or configuration cannot be used, or could not after the change; neither is changed then.
    """
    part, config = configuration.load_part(product), configuration.load(config_path)
    try:
        wanted = GraspConfig.model_validate((part.grasp or GraspConfig()).model_dump() | _given(wish))
        part = PartConfig.model_validate(part.model_dump() | {"grasp": wanted})
        jaws = JawsConfig.model_validate(config.jaws.model_dump() | _given(fingers))
    except ValidationError as error:
        raise UsageError(f"{product}: {_in_words(error)}") from error
    _refuse(part, jaws, config_path)
    if _given(fingers):
        config = changed.put(config_path, "jaws", _texts(fingers), configuration.load)
        console.print(f"{config_path}: {_jaws_in_words(config.jaws)}", markup=False)
    if _given(wish):
        part = changed.put(product, "grasp", _texts(wish), configuration.load_part)
    console.print(f"{product}: {_grasp_in_words(part, config)}", markup=False)
    if preview is not None:
        draw(preview, part, config)
        console.print(f"preview: {preview}", markup=False)
    return 0


def _given(values: Wish | Fingers) -> dict[str, float]:
    """What was asked for, by the name of its key."""
    return {key: value for key, value in asdict(values).items() if value is not None}


def _texts(values: Wish | Fingers) -> dict[str, str]:
    return {key: f"{value:g}" for key, value in _given(values).items()}


def _in_words(error: ValidationError) -> str:
    first = error.errors()[0]
    key = ".".join(str(word) for word in first["loc"])
    return f"{key} {first['input']}: {first['msg']}" if key else first["msg"].removeprefix("Value error, ")


def _grasp_in_words(part: PartConfig, config: CellConfig) -> str:
    wanted = part.grasp or GraspConfig()
    leans = (
        f"; where that has no room, leaning up to {math.degrees(wanted.free_rotation_rad):.0f} degrees about "
        "the part"
        if wanted.free_rotation_rad
        else ""
    )
    return (
        f"gripped {1e3 * wanted.from_middle_m:g} mm from the middle, give or take "
        f"{1e3 * _slack_m(part, wanted):g} mm; from {1e3 * _approach_m(wanted, config):g} mm above, lifted "
        f"by {1e3 * _retreat_m(wanted, config):g} mm at least; the hand goes straight down{leans}"
    )


def _jaws_in_words(jaws: JawsConfig) -> str:
    return (
        f"jaws open {1e3 * jaws.opening_m:g} mm; fingers {1e3 * jaws.width_m:g} mm along the part, "
        f"{1e3 * jaws.thickness_m:g} mm across it, {1e3 * jaws.depth_m:g} mm deep"
    )


def _slack_m(part: PartConfig, wanted: GraspConfig) -> float:
    return 0.4 * part.length_m if wanted.slack_m is None else wanted.slack_m


def _approach_m(wanted: GraspConfig, config: CellConfig) -> float:
    return wanted.approach_height_m or config.workspace.approach_height_m


def _retreat_m(wanted: GraspConfig, config: CellConfig) -> float:
    return wanted.retreat_height_m or _approach_m(wanted, config)


def _refuse(part: PartConfig, jaws: JawsConfig, config_path: Path) -> None:
    """Raise `UsageError` for what the jaws cannot do."""
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
            for words, x, low_to_high, side_of in (
                ("approach ", at, (tool + approach, tool), "right"),
                (" retreat", at + wide / 2 + 6, (tool, tool + retreat), "left"),
            ):
                axes.annotate(
                    "",
                    (x, low_to_high[1]),
                    (x, low_to_high[0]),
                    arrowprops={"arrowstyle": "->", "color": "tab:red"},
                )
                axes.text(x, max(low_to_high) - 4, words, ha=side_of, fontsize=8)
    _frame(axes, long / 2 + 15, tool + max(approach, retreat) + 12)
    axes.set_title("along the part (green: where the jaws may go)", fontsize=9)


def _across(axes: Axes, part: PartConfig, config: CellConfig) -> None:
    """The end of the part between the open jaws; faint how far the hand may lean, about a part that lies
    high enough for it."""
    jaws, leans = config.jaws, (part.grasp or GraspConfig()).free_rotation_rad
    _, tips = _heights_mm(part, config)
    thick, radius = 1e3 * jaws.thickness_m, 500 * part.diameter_m
    half, deep = 1e3 * jaws.opening_m / 2, 1e3 * jaws.depth_m
    lowest = 1e3 * config.workspace.floor_clearance_m
    lift = max(0.0, lowest + (half + thick) * math.sin(leans) - (tips - radius) * math.cos(leans) - radius)
    for angle, lifted, alpha in (
        (0.0, 0.0, 0.55),
        *([(leans, lift, 0.2), (-leans, lift, 0.2)] if leans else []),
    ):
        turn = Affine2D().rotate_around(0.0, radius, angle).translate(0.0, lifted) + axes.transData
        for left in (-half - thick, half):
            finger = Rectangle((left, tips), thick, deep, facecolor="tab:blue", edgecolor="0.2", alpha=alpha)
            finger.set_transform(turn)
            axes.add_patch(finger)
        axes.add_patch(
            Circle((0, radius + lifted), radius, facecolor="tan", edgecolor="0.3", alpha=min(1.0, 2 * alpha))
        )
    axes.annotate("", (-half, 0.8 * deep), (half, 0.8 * deep), arrowprops={"arrowstyle": "<->"})
    axes.text(0, 0.83 * deep, f"opens {2 * half:g} mm", ha="center", fontsize=8)
    side = (half + thick) * math.cos(leans) + deep * math.sin(leans)
    _frame(axes, side + 15, lift + deep + 12 + (half + thick) * math.sin(leans))
    allowed = f"; may lean {math.degrees(leans):.0f}° about the part" if leans else ""
    axes.set_title(f"across it; tips {tips:.1f} mm above the floor{allowed}", fontsize=9)


def _frame(axes: Axes, side_mm: float, top_mm: float) -> None:
    axes.axhline(0, color="0.2", linewidth=1.2)
    axes.set_xlim(-side_mm, side_mm)
    axes.set_ylim(-8, top_mm)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
