"""The drift watch of a running cell: each look feeds it, a small file keeps it; the alarm is the cell's.

It never corrects anything. The file belongs to one calibration: with another one the trends begin anew.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from cell.calibration_file import Json
from cell.commissioning import DriftConfig
from cell.errors import ConfigError
from cell.logs import logger
from vision.drift import Drift, Drifted, Limits, Trend, alarms, observe
from vision.types import Scene

log = logger("drift")

KEPT: Final = 200
"""Looks whose numbers are kept for the eye."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Watched:
    """What the file holds. ``looks`` newest last: rows px (NaN: too few ends) and length share of each."""

    calibration: str
    drift: Drift = field(default_factory=Drift)
    looks: tuple[tuple[float, float], ...] = ()


class DriftWatch:
    """Fed by the cell's thread with each finished look."""

    def __init__(self, path: Path, config: DriftConfig, calibration: Path) -> None:
        self._path = path
        self.limits = limits_of(config)
        self._watched = load(path, fingerprint(calibration))

    def drifted(self) -> str | None:
        """What is beyond its limit, in words; None while all is well."""
        return "; ".join(map(in_words, alarms(self._watched.drift, self.limits))) or None

    def look(self, scene: Scene, part_code: int, length_m: float) -> None:
        """One more look."""
        lengths = [c.length_m for c in scene.recognised if c.part_code == part_code]
        rows = scene.rows_seen_px if math.isfinite(scene.rows_seen_px) else None
        if not lengths and rows is None:
            return
        watched = self._watched
        drift = observe(watched.drift, rows, lengths, length_m, self.limits)
        median = sorted(lengths)[len(lengths) // 2] / length_m if lengths else math.nan
        shown = (math.nan if rows is None else rows, median)
        self._watched = replace(watched, drift=drift, looks=(*watched.looks, shown)[-KEPT:])
        try:
            save(self._path, self._watched)
        except OSError as error:
            log.warning("drift_not_kept", file=str(self._path), detail=str(error))


def in_words(drifted: Drifted) -> str:
    """One trend beyond its limit.

    >>> in_words(Drifted(what="rows", value=0.81, reference=0.1, limit=0.5, unit="px"))
    'rows: 0.8100 px, 0.1000 expected, limit 0.5'
    """
    return (
        f"{drifted.what}: {drifted.value:.4f} {drifted.unit}".rstrip()
        + f", {drifted.reference:.4f} expected, limit {drifted.limit:g}"
    )


def limits_of(config: DriftConfig) -> Limits:
    """The limits as the mathematics takes them."""
    return Limits(rows_px=config.row_limit_px, length=config.length_limit, memory_looks=config.memory_looks)


def fingerprint(calibration: Path) -> str:
    """Which calibration a trend belongs to: the hash of its file."""
    try:
        return hashlib.sha256(calibration.read_bytes()).hexdigest()
    except OSError:
        return ""


def load(path: Path, calibration: str) -> Watched:
    """What was kept of this calibration; a new beginning where there is nothing, or of another one.

    Raises
    ------
    ConfigError
        The file is there and is not one of ours: it would be overwritten.
    """
    if not path.exists():
        return Watched(calibration=calibration)
    try:
        data: Json = json.loads(path.read_text(encoding="utf-8"))
        assert isinstance(data, dict)
        if data["calibration"] != calibration:
            return Watched(calibration=calibration)
        looks = data["looks"]
        assert isinstance(looks, list)
        return Watched(
            calibration=calibration,
            drift=Drift(rows_px=_trend(data["rows_px"]), length=_trend(data["length"])),
            looks=tuple(_pair(look) for look in looks),
        )
    except (OSError, ValueError, KeyError, TypeError, AssertionError) as error:
        raise ConfigError(
            path, None, f"not a drift file ({error}); move it away or correct commissioning.drift_file"
        ) from error


def _trend(data: Json) -> Trend:
    assert isinstance(data, dict)
    value, reference, looks = data["value"], data["reference"], data["looks"]
    assert isinstance(value, int | float)
    assert isinstance(looks, int)
    return Trend(
        value=float(value),
        reference=float(reference) if isinstance(reference, int | float) else math.nan,
        looks=looks,
    )


def _pair(look: Json) -> tuple[float, float]:
    assert isinstance(look, list)
    rows, length = (float(v) if isinstance(v, int | float) else math.nan for v in look)
    return rows, length


def save(path: Path, watched: Watched) -> None:
    """Write whole or not at all. Raises `OSError`."""

    def plain(value: float) -> float | None:
        return round(value, 6) if math.isfinite(value) else None

    trends: dict[str, Json] = {
        name: {"value": plain(t.value), "reference": plain(t.reference), "looks": t.looks}
        for name, t in (("rows_px", watched.drift.rows_px), ("length", watched.drift.length))
    }
    looks: list[Json] = [[plain(rows), plain(length)] for rows, length in watched.looks]
    document: dict[str, Json] = {"calibration": watched.calibration, **trends, "looks": looks}
    beside = path.with_name(path.name + ".new")
    beside.write_text(json.dumps(document) + "\n", encoding="utf-8")
    beside.replace(path)
