"""Tables as a person reads them: on a terminal of 120 columns, and in a page of documentation."""

from __future__ import annotations

import math
from collections.abc import Container
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

COLUMNS = 120
LONG_TEXT = 30
"""Cells longer than this may be broken into lines."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sheet:
    """One table: what it shows, the command that makes it, its cells, and what a reader must know."""

    title: str
    command: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()


def show(sheet: Sheet) -> None:
    """Print it."""
    console = Console(width=COLUMNS, highlight=False)
    table = Table(
        title=sheet.title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    numeric = [all(_figures(row[i]) for row in sheet.rows) for i in range(len(sheet.headings))]
    for i, heading in enumerate(sheet.headings):
        narrow = max((len(row[i]) for row in sheet.rows), default=0) <= LONG_TEXT
        table.add_column(heading, justify="right" if numeric[i] else "left", no_wrap=narrow)
    for row in sheet.rows:
        table.add_row(*row)
    console.print(table)
    for note in sheet.notes:
        console.print(note, markup=False)
    console.print()


def _figures(cell: str) -> bool:
    """Whether a cell holds figures, or nothing: such columns stand to the right."""
    return not any(letter.isalpha() for letter in cell)


def page(sheet: Sheet, told: Container[str] = ()) -> str:
    """The same as a section in Markdown, without the notes that were told before."""
    lines = [f"## {sheet.title}", "", f"`{sheet.command}`", ""]
    lines.append("| " + " | ".join(_inline(heading) for heading in sheet.headings) + " |")
    right = [all(_figures(row[i]) for row in sheet.rows) for i in range(len(sheet.headings))]
    lines.append("|" + "".join("---:|" if one else "---|" for one in right))
    lines += ["| " + " | ".join(_inline(cell) for cell in row) + " |" for row in sheet.rows]
    for note in sheet.notes:
        if note not in told:
            lines += ["", note]
    return "\n".join(lines) + "\n"


def _inline(cell: str) -> str:
    return cell.replace("\n", " ").strip().replace("|", "\\|")


def percent(share: float) -> str:
    """A share of 1 as a percentage: whole, with decimals where rounding would hide what is missing."""
    if math.isnan(share):
        return "-"
    value = 100.0 * share
    if not 99.0 <= value < 100.0:
        return f"{value:.0f}"
    return f"{value:.1f}" if value < 99.9 else f"{min(value, 99.99):.2f}"


def number(value: float, digits: int = 2) -> str:
    """A number, or a dash."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def milliseconds(value: float) -> str:
    """Three figures."""
    if math.isnan(value):
        return "-"
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}"


def spread(pair: tuple[float, float], digits: int = 2) -> str:
    """Median and 95th percentile as ``median/p95``."""
    return "-" if math.isnan(pair[0]) else f"{pair[0]:.{digits}f}/{pair[1]:.{digits}f}"
