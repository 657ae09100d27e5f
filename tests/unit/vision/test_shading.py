"""The place of a round rod from its light, on exact Lambert profiles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from vision import shading
from vision.shading import HALF_SAMPLES, REACH, SAMPLES, Flanks, best_optics, fit_rods, pooled
from vision.types import Floats

WHERE = (np.arange(SAMPLES) - HALF_SAMPLES) / HALF_SAMPLES * REACH


def profile(
    place: float, blur: float, light: tuple[float, float, float], ground: tuple[float, float] = (0.1, 0.12)
) -> Floats:
    """Light across a rod at ``place`` radii, blurred, by fine sums and not by the detector's quadrature."""
    fine = np.linspace(-4.0, 4.0, 8001)
    x = fine - place
    inside = np.abs(x) < 1.0
    a, b, c = light
    sharp = np.where(x < 0, ground[0], ground[1])
    sharp[inside] = (a + b * x + c * np.sqrt(np.maximum(1 - x**2, 0.0)))[inside]
    weight = np.exp(-0.5 * ((WHERE[:, None] - fine) / blur) ** 2)
    return np.asarray((weight * sharp).sum(axis=1) / weight.sum(axis=1), np.float64)


@settings(max_examples=60, deadline=None)
@given(
    place=st.floats(-0.25, 0.25),
    turn=st.floats(0.0, 2 * np.pi),
    rise=st.floats(0.15, 1.4),
    blur=st.sampled_from(shading.BLURS[1:]),
)
def test_the_place_is_found_to_a_hundredth_of_a_radius_whatever_the_light(
    place: float, turn: float, rise: float, blur: float
) -> None:
    # only the part of the direction across the rod and the one towards the camera matter
    across, towards = np.cos(turn) * np.cos(rise), np.sin(rise)
    seen = profile(place, blur, (0.35, 0.3 * across, 0.5 * towards))

    found, left = fit_rods(seen[None], blur)

    assert found[0] == pytest.approx(place, abs=0.01)
    assert left[0] < 0.005


def test_the_steepest_grey_of_the_dark_flank_is_not_where_the_rod_ends_but_the_fit_is() -> None:
    # lit from the left, dark on the right: its outline at +1 is hardly seen
    seen = profile(0.0, 0.2, (0.12, -0.35, 0.4), (0.05, 0.05))

    steepest = float(WHERE[np.argmin(np.gradient(seen)[WHERE > 0]) + HALF_SAMPLES + 1])
    found, _ = fit_rods(seen[None], 0.2)

    assert abs(steepest - 1.0) > 0.1
    assert found[0] == pytest.approx(0.0, abs=0.01)


def test_something_that_is_no_rod_leaves_much_unexplained() -> None:
    bright = profile(0.0, 0.2, (0.4, 0.0, 0.4))
    glint = bright + 0.5 * np.exp(-0.5 * ((WHERE - 0.3) / 0.12) ** 2)

    _, left = fit_rods(np.stack([bright, glint]), 0.2)

    assert left[0] < 0.005
    assert left[1] > shading.WORST_SHARE


@pytest.mark.parametrize("gamma", shading.GAMMAS)
def test_gamma_and_blur_are_told_from_the_profiles(gamma: float) -> None:
    random = np.random.default_rng(4)
    blur = 0.24
    lights = [(0.3, float(random.uniform(-0.3, 0.3)), float(random.uniform(0.2, 0.5))) for _ in range(12)]
    light = np.array([profile(float(random.uniform(-0.1, 0.1)), blur, of) for of in lights])
    grey = np.clip(light, 0, 1) ** (1 / gamma)
    read = np.stack([grey**of for of in shading.GAMMAS])

    found, found_blur = best_optics(read)

    assert shading.GAMMAS[found] == gamma
    assert found_blur == pytest.approx(blur, abs=0.031)


def test_light_of_grey_is_the_power_law() -> None:
    for light, gamma in zip(shading.light_of_grey().T, shading.GAMMAS, strict=True):
        assert light[[0, 128, 255]] == pytest.approx([0, (128 / 255) ** gamma, 1])


def test_the_quadrature_of_the_basis_is_the_integral() -> None:
    blur, at = 0.2, 0.9

    def share(x: float) -> float:
        return float(np.exp(-0.5 * ((at - x) / blur) ** 2) / (blur * np.sqrt(2 * np.pi)) * np.sqrt(1 - x * x))

    exact = quad(share, -1, 1)[0]
    angle = ((np.arange(shading.QUADRATURE) + 0.5) / shading.QUADRATURE - 0.5) * np.pi
    spread = np.exp(-0.5 * ((at - np.sin(angle)) / blur) ** 2) * np.cos(angle) * np.pi / shading.QUADRATURE
    assert (spread * np.cos(angle)).sum() / (blur * np.sqrt(2 * np.pi)) == pytest.approx(exact, rel=1e-3)


def flanks(shift_of_way: Floats, normals: Floats, stations: Floats, spoilt: Floats | None = None) -> Flanks:
    """Readings of N parts in one view: a flank that looks along n is ``shift_of_way @ (1, n)`` inside."""
    outward_low = np.column_stack([np.ones(len(normals)), -normals])
    outward_high = np.column_stack([np.ones(len(normals)), normals])
    low, high = outward_low @ shift_of_way, -(outward_high @ shift_of_way)
    if spoilt is not None:
        low = low + spoilt
    return Flanks(
        low_px=np.stack([low, 0 * low], axis=1),
        high_px=np.stack([high, 0 * high], axis=1),
        stations=np.stack([stations, np.zeros(len(normals))], axis=1),
        normal=np.stack([normals, normals], axis=1),
    )


def test_what_many_parts_say_of_the_light_is_lent_to_those_that_say_nothing() -> None:
    angle = np.linspace(0, np.pi, 24, endpoint=False)
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    truth = np.array([0.2, 0.15, -0.1])
    stations = np.full(24, 60.0)
    stations[5] = 0.0
    spoilt = np.zeros(24)
    spoilt[9] = 3.0
    found = flanks(truth, normals, stations, spoilt)
    found.low_px[5] = found.high_px[5] = 99.0

    shift = pooled(found)

    assert shift[5, 0, 0] == pytest.approx(0.2 + truth[1:] @ -normals[5], abs=0.02)
    assert shift[5, 0, 1] == pytest.approx(-(0.2 + truth[1:] @ normals[5]), abs=0.02)
    assert np.abs(shift[:, 1]).max() == 0.0


def test_a_part_with_many_stations_is_believed_beside_the_others() -> None:
    angle = np.linspace(0, np.pi, 20, endpoint=False)
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    stations = np.full(20, 20.0)
    stations[3] = 200.0
    found = flanks(np.array([0.2, 0.0, 0.0]), normals, stations)
    found.low_px[3, 0] = 0.5

    shift = pooled(found)

    own = 200.0 / (200.0 + shading.OWN_STATIONS)
    assert shift[3, 0, 0] == pytest.approx(own * 0.5 + (1 - own) * 0.2, abs=0.02)
    assert shift[4, 0, 0] == pytest.approx(0.2, abs=0.06)
