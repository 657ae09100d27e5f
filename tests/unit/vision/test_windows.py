"""Lines of both pictures to parts in space: the known length completes, other lengths are strays."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.looks import ROD, Seen, drawn, ends_px, frame
from tests.reference.sticks import DEPTH_M, Stick, lying
from vision.canvas import in_space
from vision.proposals import lines
from vision.refine import KIND, LENGTH, SCORE, UNIT
from vision.strays import strays
from vision.types import Floats
from vision.windows import distinct, windows

FRAME = frame()
NONE = np.zeros((0, 4))


def proposed(of: Seen, others: bool = False) -> Floats:
    left, right = (lines(of_one, NONE, FRAME.width_px, FRAME.length_px) for of_one in (of.left, of.right))
    planes = np.stack([FRAME.low, FRAME.high])
    if others:
        return strays(left, right, FRAME.on, planes, ROD.length_m, FRAME.length_px, FRAME.unit)
    return windows(left, right, FRAME.on, planes, ROD.length_m, FRAME.width_px, FRAME.length_px, FRAME.unit)


def off_px(rows: Floats, stick: Stick) -> Floats:
    """(N,) how far each row is off a stick, the worst of its six numbers, whichever way it runs."""
    truth = ends_px(stick, FRAME)
    turned = np.concatenate([truth[3:], truth[:3]])
    straight, turned = (np.abs(rows[:, 1:7] - other).max(axis=1) for other in (truth, turned))
    return np.asarray(np.minimum(straight, turned), np.float64)


@pytest.mark.parametrize("angle_deg", [0, 5, 30, 60, 90, 135])
def test_a_stick_is_proposed_to_a_few_pixels_at_every_angle(angle_deg: int) -> None:
    stick = lying(0.01, -0.01, angle_deg)

    rows = proposed(drawn([stick], FRAME))

    assert off_px(rows, stick).min() < 3.0
    # the best of all is the stick, or (along the baseline) a twin of it a little higher or lower
    assert off_px(rows[:5], stick).min() < 6.0


def test_every_proposal_has_the_length_of_the_part() -> None:
    rows = proposed(drawn([lying(0.0, 0.0, 20), lying(0.02, 0.02, 110)], FRAME))

    ends = in_space(rows[:, 1:7].reshape(-1, 2, 3), FRAME.on)
    assert np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) == pytest.approx(0.1, rel=0.03)
    assert (rows[:, [LENGTH, KIND, UNIT]] == (0.1, 0.0, FRAME.unit)).all()
    assert (np.diff(rows[:, SCORE]) <= 0).all()


def test_a_hidden_end_is_completed_by_the_known_length() -> None:
    stick = lying(0.0, 0.0, 60)
    along = (stick.end - stick.start) / 0.1
    cover_at = stick.end - 0.006 * along
    cover = Stick(
        start=np.array([cover_at[0] - 0.05, cover_at[1], DEPTH_M - 0.012]),
        end=np.array([cover_at[0] + 0.05, cover_at[1], DEPTH_M - 0.012]),
        radius_m=0.008,
    )

    rows = proposed(drawn([stick, cover], FRAME))

    assert off_px(rows, stick).min() < 3.0


@pytest.mark.parametrize("length_m", [0.06, 0.13, 0.16])
def test_a_stick_of_another_length_is_a_stray_between_its_two_ends(length_m: float) -> None:
    stick = lying(0.0, 0.0, 50, length_m=length_m)

    rows = proposed(drawn([stick], FRAME), others=True)

    assert off_px(rows, stick).min() < 4.0
    assert (rows[:, LENGTH] == 0.0).all()
    assert (rows[:, KIND] < 0).all()


def test_a_stick_of_the_right_length_is_no_stray() -> None:
    stick = lying(0.0, 0.0, 50)

    rows = proposed(drawn([stick], FRAME), others=True)

    assert len(rows) == 0 or off_px(rows, stick).min() > 3.0


def test_what_only_one_picture_shows_is_no_part() -> None:
    left, empty = drawn([lying(0.0, 0.0, 60)], FRAME), drawn([], FRAME)

    rows = proposed(Seen(greys=left.greys, left=left.left, right=empty.right))

    assert len(rows) == 0


def test_doubles_are_the_same_part_either_way_round_and_the_first_is_kept() -> None:
    one = np.arange(10.0)
    turned = one.copy()
    turned[1:4], turned[4:7] = one[4:7], one[1:4]
    near, far = one.copy(), one.copy()
    near[1:7] += 0.4
    far[5] += 2.0

    assert distinct(np.stack([one, turned, near, far]), 0.5).tolist() == [0, 3]
