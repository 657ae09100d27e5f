"""Goals of the detector beside what was measured: one line each, reached or not."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bench import tables
from bench.looks import Look
from bench.scoring import EXPECTED_INSIDE, Summary, summary

Figure = Callable[[Summary], float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """``figure`` of all scenes of ``families`` should be at least (shares) or at most (errors) ``limit``."""

    families: tuple[str, ...]
    what: str
    figure: Figure
    limit: float
    share: bool = True

    def reached(self, value: float) -> bool:
        """Whether a figure is good enough; one that could not be measured is not."""
        return value >= self.limit - 1e-9 if self.share else value <= self.limit + 1e-9


def _shares(family: str, recall: float, pickable: float, precision: float) -> tuple[Goal, ...]:
    return (
        Goal(families=(family,), what="recall", figure=lambda s: s.recall, limit=recall),
        Goal(families=(family,), what="recall of pickable ones", figure=lambda s: s.pickable, limit=pickable),
        Goal(families=(family,), what="precision", figure=lambda s: s.precision, limit=precision),
    )


def _first(*families: str) -> tuple[Goal, ...]:
    return (
        Goal(families=families, what="first pick right, pickable", figure=lambda s: s.first, limit=1.0),
        Goal(families=families, what="first pick right, nothing on it", figure=lambda s: s.free, limit=1.0),
    )


def _both(*families: str) -> tuple[Goal, ...]:
    return (
        Goal(families=families, what="recall", figure=lambda s: s.recall, limit=1.0),
        Goal(families=families, what="precision", figure=lambda s: s.precision, limit=1.0),
    )


SHARP = ("A", "B", "H10")
GOALS: tuple[Goal, ...] = (
    *_both("A", "B"),
    *_shares("H10", 1.0, 1.0, 1.0),
    *_shares("H20", 0.99, 1.0, 1.0),
    *_shares("H40", 0.97, 0.98, 0.98),
    *_first("A", "B", "H10", "H20", "H40"),
    *(
        Goal(families=(name,), what="upper one ranked first", figure=lambda s: s.ranked, limit=limit)
        for name, limit in (("H10", 1.0), ("H20", 0.99), ("H40", 0.98))
    ),
    Goal(families=SHARP, what="middle, median mm", figure=lambda s: s.middle_mm[0], limit=0.2, share=False),
    Goal(families=SHARP, what="middle, p95 mm", figure=lambda s: s.middle_mm[1], limit=0.6, share=False),
    Goal(families=SHARP, what="axis, median °", figure=lambda s: s.axis_deg[0], limit=0.12, share=False),
    Goal(families=SHARP, what="axis, p95 °", figure=lambda s: s.axis_deg[1], limit=0.7, share=False),
    *_both("T"),
    Goal(families=("T",), what="depth, p95 mm", figure=lambda s: s.depth_mm[1], limit=1.0, share=False),
    *_both("C", "L"),
    *_first("C", "L"),
    *_both("F"),
    Goal(families=("D", "E", "G"), what="recall", figure=lambda s: s.recall, limit=1.0),
    Goal(families=("N",), what="false picks", figure=lambda s: s.false_picks, limit=0.0, share=False),
    *(
        Goal(
            families=(name,), what="middle inside 2 sigma", figure=lambda s: s.inside_m, limit=EXPECTED_INSIDE
        )
        for name in ("A", "B", "C", "H10", "H20", "H40", "L", "T")
    ),
    *(
        Goal(
            families=(name,), what="axis inside 2 sigma", figure=lambda s: s.inside_rad, limit=EXPECTED_INSIDE
        )
        for name in ("A", "B", "C", "H10", "H20", "H40", "L", "T")
    ),
)


def sheet(title: str, looks: Sequence[Look], command: str) -> tables.Sheet:
    """The goals for which there are scenes."""
    lines, reached = [], 0
    for goal in GOALS:
        here = [one for one in looks if one.family in goal.families]
        if not here:
            continue
        ours, theirs = (
            goal.figure(summary(one.score for one in here if one.method == method))
            for method in ("default", "published")
        )
        good = goal.reached(ours)
        reached += good
        lines.append(
            (
                ", ".join(sorted({one.family for one in here}, key=goal.families.index)),
                goal.what,
                _told(goal, goal.limit),
                _told(goal, ours),
                "yes" if good else "not measured" if math.isnan(ours) else "NO",
                _told(goal, theirs),
            )
        )
    return tables.Sheet(
        title=f"{title} {reached} of {len(lines)} reached",
        command=command,
        headings=("scenes", "what", "goal", "default", "reached", "published"),
        rows=tuple(lines),
        notes=("Shares in %: at least; errors and counts: at most. All scenes of the families together.",),
    )


def _told(goal: Goal, value: float) -> str:
    if goal.share:
        return tables.percent(value)
    return tables.number(value, 0 if goal.what == "false picks" else 2)
