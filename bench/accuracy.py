"""Rows of the accuracy tables: one family of scenes, one method."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bench.looks import Look, median_of
from bench.scoring import EXPECTED_INSIDE, SIGMAS, Summary, summary
from bench.tables import milliseconds, percent, spread
from vision.types import Method


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """What one method came to on one family."""

    family: str
    method: Method
    summary: Summary
    first_ms: float
    whole_ms: float
    ratio: float


SHORT: dict[Method, str] = {"published": "publ.", "default": "default"}
MOST_NAMED = 12
"""Scenes a note names."""

HEADINGS = (
    *("scenes", "method", "rec.\n%", "pick.\n%", "prec.\n%", "first\n%", "free\n%", "over\n%"),
    *("middle\nmm", "end\nmm", "axis\n°", "in 2σ\nmm/°", "first\nms", "all\nms", "all/\nthin"),
)

NOTES = (
    "rec. (recall): of parts seen to at least a half in both pictures; pick.: of those with a free central "
    "third; prec. (precision): right ones of all that were found; first: the first pick is right and "
    "pickable; free: it is offered, right, and nothing at all lies on it; over: of two found parts, one over "
    "the middle of the other, the upper one is ranked first / of all of which one lies over the other, the "
    "detector says so (one figure: both the same, or it says nothing). Right: middle within 5 mm across and "
    "8 mm along the sight, axis within 5°, length within 10 % (plates 8, 10 mm, 6°, 15 %), one to one.",
    "middle, end, axis: median/95th percentile of right ones. in 2σ: share of errors inside twice the stated "
    f"sigma (an honest detector has {EXPECTED_INSIDE:.0%} inside {SIGMAS:g}); - where none is stated. ms: "
    "of processor time, one pair, files read. all/thin: that over skimage.morphology.skeletonize of the same "
    "two masks.",
)


def row(family: str, method: Method, looks: Iterable[Look]) -> Row:
    """Add looks up."""
    some = list(looks)
    return Row(
        family=family,
        method=method,
        summary=summary(one.score for one in some),
        first_ms=median_of([one.first_ms for one in some]),
        whole_ms=median_of([one.whole_ms for one in some]),
        ratio=median_of([one.ratio for one in some]),
    )


def cells(one: Row) -> tuple[str, ...]:
    """A row as text, under `HEADINGS`."""
    total = one.summary
    return (
        f"{one.family} ({total.looks})",
        SHORT[one.method],
        percent(total.recall),
        percent(total.pickable),
        percent(total.precision),
        percent(total.first),
        percent(total.free),
        _pair(total.ranked, total.told),
        spread(total.middle_mm),
        spread(total.end_mm, 1),
        spread(total.axis_deg),
        _pair(total.inside_m, total.inside_rad),
        milliseconds(one.first_ms),
        milliseconds(one.whole_ms),
        milliseconds(one.ratio),
    )


def _pair(first: float, second: float) -> str:
    """Two shares; one where they are told alike, or where there is no second."""
    told = [percent(first), percent(second)]
    return told[0] if told[0] == told[1] or np.isnan(second) else "/".join(told)


def by_size(family: str) -> tuple[str, int]:
    """Sorting key: A before B, H10 before H20 before H40."""
    letters = re.match(r"\D*", family)
    digits = re.search(r"\d+", family)
    return (letters.group() if letters else "", int(digits.group()) if digits else 0)


def rows(looks: Sequence[Look]) -> tuple[Row, ...]:
    """A row a family and method, then one a method for all; scenes with nothing to pick are left out."""
    some = [one for one in looks if not one.score.negative]
    names = sorted({one.family for one in some}, key=by_size)
    methods = list(dict.fromkeys(one.method for one in some))
    found = [
        row(name, method, [one for one in some if one.family == name and one.method == method])
        for name in names
        for method in methods
    ]
    if len(names) > 1:
        found += [row("all", method, [one for one in some if one.method == method]) for method in methods]
    return tuple(found)


def false_picks(looks: Sequence[Look]) -> tuple[str, ...]:
    """What was found where there is nothing to pick, as a note; none without such scenes."""
    empty = [one for one in looks if one.score.negative]
    told = []
    for method in dict.fromkeys(one.method for one in empty):
        here = [one for one in empty if one.method == method]
        false = [one for one in here if one.score.found]
        where = ", ".join(f"{one.name} {one.score.found}" for one in false)
        count = sum(one.score.found for one in false)
        told.append(f"{method} {count} in {len(here)} scenes" + (f" ({where})" if where else ""))
    return (f"False picks where there is nothing to pick: {'; '.join(told)}.",) if told else ()


def wrong_firsts(looks: Sequence[Look], method: Method) -> str:
    """Where the first pick of a method is wrong or covered, as a note."""
    wrong = [one.name for one in looks if one.method == method and one.score.free is False]
    more = f" and {len(wrong) - MOST_NAMED} more" if len(wrong) > MOST_NAMED else ""
    return f"First pick of {method} not right and free: {', '.join(wrong[:MOST_NAMED]) or 'nowhere'}{more}."
