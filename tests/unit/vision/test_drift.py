"""The drift watch: quiet on a good cell, loud on a moved one, and silent about single bad looks."""

from __future__ import annotations

import numpy as np

from vision.drift import SETTLED_LOOKS, Drift, Limits, alarms, observe

LIMITS = Limits(rows_px=0.5, length=0.01, memory_looks=20.0)


def watched(rows_px: list[float], share: list[float]) -> Drift:
    drift = Drift()
    for row, length in zip(rows_px, share, strict=True):
        drift = observe(drift, row, [0.1 * length] * 3, 0.1, LIMITS)
    return drift


def test_a_good_cell_raises_nothing_in_a_thousand_looks() -> None:
    rng = np.random.default_rng(3)
    drift = watched(rng.normal(0.05, 0.3, 1000).tolist(), rng.normal(1.002, 0.006, 1000).tolist())
    assert alarms(drift, LIMITS) == ()


def test_rows_that_move_raise_an_alarm() -> None:
    drift = watched([0.1] * 30 + [0.9] * 40, [1.0] * 70)
    assert [each.unit for each in alarms(drift, LIMITS)] == ["px"]


def test_a_rig_that_was_off_from_the_first_day_is_told_too() -> None:
    assert len(alarms(watched([0.8] * 20, [1.0] * 20), LIMITS)) == 1


def test_a_common_scale_shows_in_the_lengths_only() -> None:
    found = alarms(watched([0.0] * 60, [1.0] * 20 + [1.02] * 40), LIMITS)
    assert [each.unit for each in found] == [""]


def test_one_bad_look_is_not_an_alarm_and_a_young_trend_has_no_say() -> None:
    assert alarms(watched([0.0] * 30 + [4.0], [1.0] * 31), LIMITS) == ()
    young = SETTLED_LOOKS - 1
    assert alarms(watched([3.0] * young, [1.1] * young), LIMITS) == ()


def test_looks_without_ends_or_parts_change_nothing() -> None:
    drift = watched([0.1] * 10, [1.0] * 10)
    assert observe(drift, None, [], 0.1, LIMITS) == drift
