"""A device's clock on ours: the line under the arrivals, wrap of frame numbers."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.camera.device_clock import DeviceClock, fit, missed

OFFSET_S = 5000.0
LEAST_S = 0.004


def arrivals(seconds: float, drift: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """30 frames a second that come LEAST_S later or, mostly, later than that."""
    rng = np.random.default_rng(seed)
    device = np.arange(0.0, seconds, 1 / 30)
    late = LEAST_S + rng.exponential(0.003, device.size)
    late[rng.integers(0, device.size, 3)] = LEAST_S
    return device, OFFSET_S + device * (1.0 + drift) + late


@pytest.mark.parametrize("drift", [0.0, 40e-6, -40e-6])
def test_the_line_lies_under_every_arrival_and_finds_the_drift(drift: float) -> None:
    device, ours = arrivals(120.0, drift)
    line = fit(device, ours)
    below = ours - np.array([line.ours(float(d)) for d in device])
    assert below.min() >= -1e-9
    assert line.rate - 1.0 == pytest.approx(drift, abs=1e-5)
    true_end = OFFSET_S + device[-1] * (1.0 + drift) + LEAST_S
    assert line.ours(float(device[-1])) == pytest.approx(true_end, abs=3e-4)


def test_a_short_while_says_nothing_about_the_drift() -> None:
    device, ours = arrivals(5.0, 300e-6)
    assert fit(device, ours).rate == 1.0


def test_a_network_that_gets_slower_is_not_taken_for_a_clock() -> None:
    device = np.arange(0.0, 60.0, 0.1)
    assert fit(device, OFFSET_S + device * 1.01).rate == pytest.approx(1.0005)


def test_following_keeps_the_quickest_frame_of_each_second_and_forgets_old_ones() -> None:
    clock = DeviceClock(seconds=60)
    device, ours = arrivals(200.0, 30e-6)
    for d, o in zip(device, ours, strict=True):
        line = clock.add(float(d), float(o))
    true_end = OFFSET_S + device[-1] * (1.0 + 30e-6) + LEAST_S
    assert line.ours(float(device[-1])) == pytest.approx(true_end, abs=1e-3)


def test_a_device_that_counts_from_the_start_again_is_fitted_anew() -> None:
    clock = DeviceClock()
    clock.add(100.0, 1100.0)
    assert clock.add(0.5, 1105.0).ours(0.5) == pytest.approx(1105.0)


@pytest.mark.parametrize(
    ("before", "now", "between"),
    [
        (1, 2, 0),
        (1, 5, 3),
        (65535, 1, 0),
        (65530, 3, 7),
        (65536, 65537, 0),
        (2**40, 2**40 + 3, 2),
        (900, 1, 0),
    ],
)
def test_frame_numbers_wrap_from_65535_to_1(before: int, now: int, between: int) -> None:
    assert missed(before, now) == between
