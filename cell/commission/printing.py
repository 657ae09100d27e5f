"""From a wish on the command line to a page and its board file, and back with a ruler."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import ValidationError
from rich.console import Console

from cell.commission import boardfile, boardpdf
from cell.commission.boardfile import BoardConfig
from cell.errors import UsageError
from vision.boards import DICTIONARIES


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """A board somebody wants printed."""

    kind: Literal["charuco", "chessboard"]
    columns: int
    rows: int
    pitch_mm: float
    marker_mm: float | None
    dictionary: str | None
    paper: str
    measured_bar_mm: float | None


def print_board(wish: Wish, out: Path, console: Console) -> int:
    """Write the page, and the board file beside it under the same name; exit code 0.

    Raises
    ------
    UsageError
        The board is none, or does not fit the paper.
    """
    if out.suffix.lower() != ".pdf":
        raise UsageError(f"{out}: the board is written as PDF; let the name end in .pdf")
    is_charuco = wish.kind == "charuco"
    marker_mm = wish.marker_mm or 0.75 * wish.pitch_mm
    values: dict[str, object] = {
        "kind": wish.kind,
        "columns": wish.columns,
        "rows": wish.rows,
        "pitch_m": wish.pitch_mm / 1e3,
    }
    if is_charuco:
        values["marker_m"] = marker_mm / 1e3
        values["dictionary"] = wish.dictionary or _large_enough(wish.columns * wish.rows // 2)
    config = _config(values)
    where = boardpdf.page(config.board(), wish.paper)
    values["bar_m"] = where.bar_mm / 1e3
    config = _config(values)
    boardpdf.write(out, config, wish.paper)
    if wish.measured_bar_mm is not None:
        config = _config(values | {"measured_bar_m": wish.measured_bar_mm / 1e3})
    beside = out.with_suffix(".yaml")
    boardfile.save(beside, config)
    console.print(f"{out}: {config.words()} on {wish.paper}, bar {where.bar_mm:g} mm; {beside}")
    if not config.measured:
        console.print(
            "Print it at 100 %, glue it to something flat and stiff, measure the bar and tell:\n"
            f"  mikado calibrate board --board {beside} --measured-bar-mm ..."
        )
    return 0


def measured(path: Path, bar_mm: float, console: Console) -> int:
    """Record what the ruler says; exit code 0.

    Raises
    ------
    UsageError
        The bar cannot be that long.
    ConfigError
        The board file cannot be used.
    """
    config = boardfile.load(path)
    if config.bar_m is None:
        raise UsageError(f"{path}: has no bar_m: say how long the bar should be, then how long it is")
    config = _config(config.model_dump(exclude_none=True) | {"measured_bar_m": bar_mm / 1e3})
    boardfile.save(path, config)
    console.print(
        f"{path}: bar {bar_mm:g} mm instead of {1e3 * (config.bar_m or 0):g} mm; "
        f"the squares are {1e3 * config.board().pitch_m:.4f} mm ({100 * (config.scale - 1):+.2f} %)"
    )
    return 0


def _config(values: dict[str, object]) -> BoardConfig:
    try:
        return BoardConfig.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        said = first["msg"].removeprefix("Value error, ")
        raise UsageError(f"board: {place + ': ' if place else ''}{said}") from error


def _large_enough(markers: int) -> str:
    small = [name for name in DICTIONARIES if name.startswith("DICT_4X4") and name != "DICT_4X4_50"]
    return next((name for name in small if int(name.rsplit("_", 1)[1]) >= markers), "DICT_4X4_1000")
