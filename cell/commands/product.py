"""``mikado product ...``: a product from one part, and how it is gripped."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from cell.errors import UsageError

if TYPE_CHECKING:
    from cell.commands import Commands


def add(commands: Commands) -> None:
    """Add the parsers."""
    group = commands.add_parser("product", help="teach a product")
    kinds = group.add_subparsers(dest="kind", required=True, metavar="WHAT")
    teach = kinds.add_parser("teach", help="a product file from one part of known length; moves nothing")
    teach.add_argument("--length-mm", type=float, required=True, help="length of the part, measured")
    teach.add_argument("--left", type=Path, metavar="PICTURE")
    teach.add_argument("--right", type=Path, metavar="PICTURE")
    teach.add_argument("--calibration", type=Path, metavar="FILE")
    teach.add_argument("--config", type=Path, metavar="FILE", help="look through the configured cameras")
    teach.add_argument("--empty-left", type=Path, metavar="PICTURE", help="the tray without the part")
    teach.add_argument("--empty-right", type=Path, metavar="PICTURE")
    teach.add_argument("--depth-m", type=float, nargs=2, metavar=("MIN", "MAX"))
    teach.add_argument("--code", type=int, default=1, help="what the PLC writes as recipe (default 1)")
    teach.add_argument("--name", default="part")
    teach.add_argument("--out", type=Path, required=True, metavar="YAML")
    teach.set_defaults(run=run_teach)

    grasp = kinds.add_parser("grasp", help="where a part is gripped, with a drawn preview; moves nothing")
    grasp.add_argument("product", type=Path, metavar="YAML", help="the product file; it is changed")
    grasp.add_argument("--config", type=Path, required=True, metavar="FILE", help="jaws and workspace")
    grasp.add_argument("--from-middle-mm", type=float, help="best place along the part, either side")
    grasp.add_argument("--slack-mm", type=float, help="how far from there the jaws may look for room")
    grasp.add_argument("--approach-mm", type=float, help="height above the grasp where descent begins")
    grasp.add_argument("--retreat-mm", type=float, help="the part is lifted at least so high")
    grasp.add_argument(
        "--free-rotation-deg",
        type=float,
        help="where straight down has no room, the hand may lean so far about the part's axis (0: never)",
    )
    jaws = grasp.add_argument_group("jaws", "the fingers, written into the configuration; the whole cell's")
    jaws.add_argument("--opening-mm", type=float, help="between the open fingers")
    jaws.add_argument("--finger-width-mm", type=float, help="of a finger, along the part")
    jaws.add_argument("--finger-thickness-mm", type=float, help="of a finger, across the part")
    jaws.add_argument("--finger-depth-mm", type=float, help="from the tips up to the gripper's body")
    jaws.add_argument("--clearance-mm", type=float, help="free space a finger needs around it")
    jaws.add_argument("--tip-beyond-tool-mm", type=float, help="the tips reach so far beyond the tool point")
    jaws.add_argument("--below-axis-mm", type=float, help="the tool point goes so far below the part's axis")
    grasp.add_argument("--preview", type=Path, metavar="PNG")
    grasp.set_defaults(run=run_grasp)


def run_grasp(arguments: argparse.Namespace) -> int:
    """Set where a product is gripped."""
    from rich.console import Console

    from cell.commission import grasping

    def metres(value_mm: float | None) -> float | None:
        return None if value_mm is None else round(value_mm / 1e3, 6)

    wish = grasping.Wish(
        from_middle_m=metres(arguments.from_middle_mm),
        slack_m=metres(arguments.slack_mm),
        approach_height_m=metres(arguments.approach_mm),
        retreat_height_m=metres(arguments.retreat_mm),
        free_rotation_rad=None
        if arguments.free_rotation_deg is None
        else round(math.radians(arguments.free_rotation_deg), 4),
    )
    fingers = grasping.Fingers(
        opening_m=metres(arguments.opening_mm),
        width_m=metres(arguments.finger_width_mm),
        thickness_m=metres(arguments.finger_thickness_mm),
        depth_m=metres(arguments.finger_depth_mm),
        min_clearance_m=metres(arguments.clearance_mm),
        tip_beyond_tool_m=metres(arguments.tip_beyond_tool_mm),
        below_axis_m=metres(arguments.below_axis_mm),
    )
    console = Console(soft_wrap=True, highlight=False)
    return grasping.grasp(arguments.product, arguments.config, wish, fingers, arguments.preview, console)


def run_teach(arguments: argparse.Namespace) -> int:
    """Teach a product."""
    from rich.console import Console

    from cell.commission import teach

    if not 1.0 <= arguments.length_mm <= 2000.0:
        raise UsageError(f"--length-mm {arguments.length_mm:g}: millimetres between 1 and 2000 are expected")
    if not 1 <= arguments.code <= 65535:
        raise UsageError(f"--code {arguments.code}: 1 to 65535")
    if (arguments.empty_left is None) != (arguments.empty_right is None):
        raise UsageError("of the empty tray both pictures are needed: --empty-left and --empty-right")
    empty = None if arguments.empty_left is None else (arguments.empty_left, arguments.empty_right)
    files = (arguments.left, arguments.right, arguments.calibration)
    if arguments.config is not None:
        if any(file is not None for file in files) or arguments.depth_m is not None:
            raise UsageError(
                "--config looks through its own cameras; leave out pictures, calibration and depth"
            )
        shown = teach.from_cameras(arguments.config, empty)
    elif any(file is None for file in files):
        raise UsageError("teach needs --left, --right and --calibration, or --config FILE")
    else:
        depth = None if arguments.depth_m is None else (arguments.depth_m[0], arguments.depth_m[1])
        if depth is not None and not 0 < depth[0] < depth[1]:
            raise UsageError(f"--depth-m: min {depth[0]} is not below max {depth[1]}")
        shown = teach.from_files((arguments.left, arguments.right), empty, arguments.calibration, depth)
    taught = teach.teach(shown, arguments.length_mm / 1e3, arguments.code, arguments.name)
    return teach.write(arguments.out, taught, Console(soft_wrap=True, highlight=False))
