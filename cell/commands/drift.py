"""``mikado drift``: what production says of the calibration. Opens no device."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cell.commands import Commands


def add(commands: Commands) -> None:
    """Add the parser."""
    parser = commands.add_parser(
        "drift", help="has the calibration moved? The trend of rows and part lengths in production"
    )
    parser.add_argument("config", type=Path, metavar="CONFIG")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Show the trends; 1 when an alarm stands."""
    from rich.console import Console
    from rich.table import Table

    from cell import config as configuration
    from cell import drift
    from cell.alarm_table import TABLE, Condition
    from vision.drift import SETTLED_LOOKS, alarms

    console = Console(soft_wrap=True, highlight=False)
    config = configuration.load(arguments.config)
    kept = config.commissioning
    watched = drift.load(kept.drift_file, drift.fingerprint(config.files.calibration))
    limits = drift.limits_of(kept.drift)
    if not watched.looks:
        console.print(f"no looks yet with this calibration ({kept.drift_file})")
        return 0
    table = Table(title="drift of the calibration", title_justify="left")
    for name in ("", "looks", "at the beginning", "now (smoothed)", "limit", "last looks"):
        table.add_column(name)
    for k, (what, trend, limit, unit) in enumerate(
        (
            ("rows of the two pictures", watched.drift.rows_px, f"± {limits.rows_px:g} px", "px"),
            ("measured over true length", watched.drift.length, f"1 ± {limits.length:g}", ""),
        )
    ):
        begun = "-" if math.isnan(trend.reference) else f"{trend.reference:.4f} {unit}"
        table.add_row(
            what,
            str(trend.looks),
            begun,
            f"{trend.value:.4f} {unit}",
            limit,
            sparks([look[k] for look in watched.looks[-40:]]),
        )
    console.print(table)
    found = alarms(watched.drift, limits)
    for each in found:
        console.print(f"[red]{Condition.CALIBRATION_DRIFT.name}: {drift.in_words(each)}[/red]")
    if found:
        row = TABLE[Condition.CALIBRATION_DRIFT]
        console.print(f"  {row.consequence}; {row.action}")
    if not found:
        few = watched.drift.rows_px.looks < SETTLED_LOOKS
        console.print(f"fewer than {SETTLED_LOOKS} looks: no say yet" if few else "[green]no drift[/green]")
    return 1 if found else 0


def sparks(values: list[float]) -> str:
    """A row of bars from the least to the largest."""
    known = [v for v in values if math.isfinite(v)]
    if not known:
        return ""
    low, high = min(known), max(known)
    step = (high - low) / 7 or 1.0
    return "".join(" " if not math.isfinite(v) else "▁▂▃▄▅▆▇█"[round((v - low) / step)] for v in values)
