"""Which strand of the left picture is which of the right one.

Not a search along single rows for single nodes but of whole strands for whole strands: every pair that
could be one part is solved in space, completed with the known length where tips are hidden, laid over
both masks and priced; the cheapest consistent set of pairs wins (linear assignment).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from vision.look import Look
from vision.reconstruct_lines import DETERMINED_PX, Level, Solved, from_space, solve
from vision.stereo import Rectification, project
from vision.strands import Strands, cautious
from vision.types import Bools, Floats, Ints, Matches, PartModel, read_only

UNMATCHED_COST = 60.0
"""A strand stays alone rather than join a partner that disagrees by more, in squared deviations."""
CHI2_LIMIT = 80.0
SLACK_PX = 2.0
"""A completed end may miss the place its picture allows by this much."""
OFF_MASK_COST = 150.0
COMPLETED_COST = 5.0
DOUBT_COST = 6.0
"""A completed end, and a reading that takes a tip for wrong, must earn this much elsewhere."""
SAMPLES = 48


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placed:
    """P pairs as parts in space.

    ``solved`` the pairs as measured; ``ends_m`` (P, 2, 3) with hidden ends completed, left camera
    frame; ``completed`` (P, 2) which ends come from the known length; ``slack_m`` (P,) how far a
    part with two hidden ends could be shifted; ``cover`` (P,) least share of either mask under the
    axis; ``cost`` (P,).
    """

    solved: Solved
    ends_m: Floats
    completed: Bools
    slack_m: Floats
    cover: Floats
    cost: Floats

    @property
    def length_m(self) -> Floats:
        """(P,) distance of the ends."""
        return np.asarray(np.linalg.norm(self.ends_m[:, 1] - self.ends_m[:, 0], axis=1), np.float64)


def match(
    left: Strands, right: Strands, looks: tuple[Look, Look], level: Level, part: PartModel
) -> tuple[Matches, Placed]:
    """The cheapest one-to-one choice of pairs.

    Parameters
    ----------
    left, right : Strands
    looks : (left, right)
    level : Level
        The disparities at which parts are looked for.
    part : PartModel
        Its length completes hidden ends and prices seen ones; parts of other lengths are matched
        too, because they can lie over the wanted ones.

    Returns
    -------
    Matches, Placed
        Rows of both belong together.
    """
    pairs, flipped = _possible(left, right, level, looks[0].rect, part)
    placed = _place(left, right, pairs, flipped, looks, level, part)
    doubt_l = ~left.sure[pairs[:, 0]].all(axis=1)
    doubt_r = ~right.sure[pairs[:, 1]].all(axis=1)
    for one, other, doubtful in (
        (cautious(left), right, doubt_l),
        (left, cautious(right), doubt_r),
        (cautious(left), cautious(right), doubt_l & doubt_r),
    ):
        if doubtful.any():
            again = _place(one, other, pairs[doubtful], flipped[doubtful], looks, level, part)
            placed = _both(placed, replace(again, cost=read_only(again.cost + DOUBT_COST)))
    cheap = placed.cost < UNMATCHED_COST
    cost = np.full((len(left), len(right) + len(left)), 10 * UNMATCHED_COST)
    which = np.full((len(left), len(right)), -1, np.int64)
    cost[np.arange(len(left)), len(right) + np.arange(len(left))] = UNMATCHED_COST
    for row in np.flatnonzero(cheap).tolist():
        i, j = placed.solved.left[row], placed.solved.right[row]
        if placed.cost[row] < cost[i, j]:
            cost[i, j] = placed.cost[row]
            which[i, j] = row
    first, second = linear_sum_assignment(cost)
    chosen = [which[i, j] for i, j in zip(first, second, strict=True) if j < len(right) and which[i, j] >= 0]
    rows = np.array(chosen, np.int64)
    kept = _rows(placed, rows)
    rivals = (which >= 0).sum(axis=1) > 1
    matches = Matches(
        left=kept.solved.left,
        right=kept.solved.right,
        cost_px=kept.solved.residual_px,
        unmatched=len(left) - len(rows),
        ambiguous=int(rivals.sum()),
    )
    return matches, kept


def _possible(
    left: Strands, right: Strands, level: Level, rect: Rectification, part: PartModel
) -> tuple[Ints, Ints]:
    """Pairs whose rows overlap and whose disparity is in the band, in both orders of their ends."""
    if len(left) == 0 or len(right) == 0:
        return np.zeros((0, 2), np.int64), np.zeros(0, np.int64)
    shift = rect.left_centre_px[0] - rect.right_centre_px[0]
    low_l, high_l = np.sort(left.tips[:, :, 1], axis=1).T
    low_r, high_r = np.sort(right.tips[:, :, 1], axis=1).T
    low = np.maximum(low_l[:, None], low_r[None, :])
    high = np.minimum(high_l[:, None], high_r[None, :])
    shorter = np.minimum(left.length_px[:, None], right.length_px[None, :])
    row = 0.5 * (low + high)
    steep = np.minimum(np.abs(left.direction[:, 1])[:, None], np.abs(right.direction[:, 1])[None, :]) > 0.25
    u_left = np.where(steep, _column_at(left, row.T).T, left.tips[:, :, 0].mean(axis=1)[:, None])
    u_right = np.where(steep, _column_at(right, row), right.tips[:, :, 0].mean(axis=1)[None, :]) + shift
    disparity = u_left - u_right
    expected = level.disparity_px(np.stack([u_left, row], axis=-1))
    longest = np.maximum(left.length_px[:, None], right.length_px[None, :])
    # centres of strands that show different parts of a thing are apart by up to a length
    margin = np.where(steep, 3.0, longest)
    margin = margin + np.abs(level.px_per_m) * 0.2 * part.length_m
    good = (np.abs(disparity - expected) < level.half_px + margin) & (high - low > -3.0)
    good &= ~steep | (high - low > 0.15 * shorter)
    first, second = np.nonzero(good)
    pairs = np.stack([first, second], axis=1).astype(np.int64)
    # ends ordered by row where that is clear, by column where it is not
    delta_l = left.tips[first, 1] - left.tips[first, 0]
    delta_r = right.tips[second, 1] - right.tips[second, 0]
    by_row = np.sign(delta_l[:, 1]) != np.sign(delta_r[:, 1])
    by_column = np.sign(delta_l[:, 0]) != np.sign(delta_r[:, 0])
    flat = (np.abs(delta_l[:, 1]) < 0.25 * np.abs(delta_l[:, 0])) & (
        np.abs(delta_r[:, 1]) < 0.25 * np.abs(delta_r[:, 0])
    )
    flipped = np.where(flat, by_column, by_row).astype(np.int64)
    return pairs, flipped


def _column_at(strands: Strands, rows: Floats) -> Floats:
    """Column of strand s at rows[..., s]."""
    fall = np.where(np.abs(strands.direction[:, 1]) < 1e-6, 1e-6, strands.direction[:, 1])
    return np.asarray(
        strands.tips[:, 0, 0] + (rows - strands.tips[:, 0, 1]) * strands.direction[:, 0] / fall, np.float64
    )


def _place(
    left: Strands,
    right: Strands,
    pairs: Ints,
    flipped: Ints,
    looks: tuple[Look, Look],
    level: Level,
    part: PartModel,
) -> Placed:
    rect = looks[0].rect
    solved = solve(left, right, pairs, flipped, level, rect, part.length_m, 0.5 * part.diameter_m)
    apart = np.linalg.norm(solved.ends_m[:, 1] - solved.ends_m[:, 0], axis=1)
    sane = (solved.chi2 < CHI2_LIMIT) & np.isfinite(apart) & (apart > 2 * part.diameter_m)
    solved = rows_of(solved, np.flatnonzero(sane))
    ends_m, completed, violation_px, slack_m = _complete(solved, left, right, rect, part)
    cover = _cover(ends_m, looks)
    length_m = np.linalg.norm(ends_m[:, 1] - ends_m[:, 0], axis=1)
    misfit = np.minimum(4.0 * ((length_m - part.length_m) / part.length_tolerance_m) ** 2, 20.0)
    over = np.abs(solved.ends_px[..., 2] - level.disparity_px(solved.ends_px[..., :2])) - level.half_px
    height = np.maximum(over, 0.0) / max(0.1 * level.half_px, 1.0)
    cost = (
        solved.chi2
        + misfit
        + COMPLETED_COST * completed.sum(axis=1)
        + np.minimum(violation_px, 20.0)
        + OFF_MASK_COST * np.maximum(0.97 - cover, 0.0)
        + (height**2).sum(axis=1)
    )
    return Placed(
        solved=solved,
        ends_m=read_only(ends_m),
        completed=read_only(completed),
        slack_m=read_only(slack_m),
        cover=read_only(cover),
        cost=read_only(cost),
    )


def _complete(
    solved: Solved, left: Strands, right: Strands, rect: Rectification, part: PartModel
) -> tuple[Floats, Bools, Floats, Floats]:
    """Hidden ends moved to where the known length puts them, if both pictures allow it.

    Along the axis of a pair, each picture bounds an end: not inside what it shows of the part, and
    not beyond where the foreground ends. A window of the part's length is laid within these bounds.
    """
    count = len(solved.left)
    ends = solved.ends_m
    way = ends[:, 1] - ends[:, 0]
    apart = np.linalg.norm(way, axis=1)
    axis = way / apart[:, None]
    order = np.stack([solved.flipped, 1 - solved.flipped], axis=1)
    shift = np.array([rect.left_centre_px[0] - rect.right_centre_px[0], 0.0])
    low, high = np.full(count, -np.inf), np.full(count, np.inf)
    inner_low, inner_high = np.full(count, np.inf), np.full(count, -np.inf)
    px_per_m = np.maximum(_scale(ends, axis, rect), 1e-6)
    for side, strands in enumerate((left, right)):
        if side == 0:
            tips, reach = strands.tips[solved.left], strands.reach_px[solved.left]
            at = solved.ends_px[..., :2]
        else:
            tips = np.take_along_axis(strands.tips[solved.right], order[:, :, None], axis=1) + shift
            reach = np.take_along_axis(strands.reach_px[solved.right], order, axis=1)
            at = solved.ends_px[..., :2] - np.stack([solved.ends_px[..., 2], np.zeros((count, 2))], axis=-1)
        direction = at[:, 1] - at[:, 0]
        direction = direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
        scale = px_per_m[:, side]
        for end, sign in ((0, -1.0), (1, 1.0)):
            off = np.einsum("pk,pk->p", tips[:, end] - at[:, end], direction) / scale
            seen = off + (0.0 if end == 0 else 1.0) * apart
            limit = seen + sign * reach[:, end] / scale
            if end == 0:
                inner_low = np.minimum(inner_low, seen)
                low = np.maximum(low, limit)
            else:
                inner_high = np.maximum(inner_high, seen)
                high = np.minimum(high, limit)
    known = solved.end_sigma_px < DETERMINED_PX
    size = part.length_m
    # where the first end may be, and where the second allows it to be
    first_low = np.where(known[:, 0], 0.0, np.maximum(low, -size))
    first_high = np.where(known[:, 0], 0.0, np.maximum(inner_low, first_low))
    second_high = np.where(known[:, 1], apart, np.minimum(high, apart + size)) - size
    second_low = np.where(known[:, 1], apart, np.minimum(inner_high, second_high + size)) - size
    start = np.maximum(first_low, second_low)
    stop = np.minimum(first_high, second_high)
    gap_px = np.maximum(start - stop, 0.0) * px_per_m.mean(axis=1)
    place = 0.5 * (start + stop)
    place = np.where(known[:, 0], 0.0, np.where(known[:, 1], apart - size, place))
    fits = ~known.all(axis=1) & (gap_px < SLACK_PX + 0.02 * size * px_per_m.mean(axis=1))
    moved = np.stack(
        [ends[:, 0] + place[:, None] * axis, ends[:, 0] + (place + size)[:, None] * axis], axis=1
    )
    completed = fits[:, None] & ~known
    result = np.where(fits[:, None, None], moved, ends)
    slack = np.where(completed.all(axis=1), np.maximum(stop - start, 0.0), 0.0)
    return result, completed, np.where(known.all(axis=1), 0.0, gap_px), slack


def _scale(ends: Floats, axis: Floats, rect: Rectification) -> Floats:
    """(P, 2) px per metre along the axis at the middle of a part, in the left and the right picture."""
    middle = 0.5 * (ends[:, 0] + ends[:, 1])
    step = 1e-3
    before, after = (from_space(middle + s * step * axis, rect) for s in (-0.5, 0.5))
    change = after - before
    left = np.hypot(change[:, 0], change[:, 1])
    right = np.hypot(change[:, 0] - change[:, 2], change[:, 1])
    return np.stack([left, right], axis=1) / step


def _cover(ends_m: Floats, looks: tuple[Look, Look]) -> Floats:
    """(P,) the lesser share of both masks under the axis, a little inside the ends."""
    count = len(ends_m)
    if count == 0:
        return np.zeros(0)
    share = np.linspace(0.03, 0.97, SAMPLES)[None, :, None]
    points = ends_m[:, :1] + share * (ends_m[:, 1:] - ends_m[:, :1])
    pixels = project(points.reshape(-1, 3), looks[0].rect.stereo)
    shares = []
    for look, raw in zip(looks, pixels, strict=True):
        on = look.raw_mask_at(np.nan_to_num(raw, nan=-1.0)).reshape(count, SAMPLES)
        shares.append(on.mean(axis=1))
    return np.asarray(np.minimum(shares[0], shares[1]), np.float64)


def rows_of(solved: Solved, rows: Ints) -> Solved:
    """Some pairs of many."""
    return Solved(
        left=read_only(solved.left[rows]),
        right=read_only(solved.right[rows]),
        flipped=read_only(solved.flipped[rows]),
        ends_px=read_only(solved.ends_px[rows]),
        ends_m=read_only(solved.ends_m[rows]),
        end_sigma_px=read_only(solved.end_sigma_px[rows]),
        depth_sigma_m=read_only(solved.depth_sigma_m[rows]),
        chi2=read_only(solved.chi2[rows]),
        residual_px=read_only(solved.residual_px[rows]),
    )


def _both(first: Placed, second: Placed) -> Placed:
    """The rows of two."""

    def joined(a: Floats, b: Floats) -> Floats:
        return np.concatenate([a, b])

    one, two = first.solved, second.solved
    return Placed(
        solved=Solved(
            left=read_only(np.concatenate([one.left, two.left])),
            right=read_only(np.concatenate([one.right, two.right])),
            flipped=read_only(np.concatenate([one.flipped, two.flipped])),
            ends_px=read_only(joined(one.ends_px, two.ends_px)),
            ends_m=read_only(joined(one.ends_m, two.ends_m)),
            end_sigma_px=read_only(joined(one.end_sigma_px, two.end_sigma_px)),
            depth_sigma_m=read_only(joined(one.depth_sigma_m, two.depth_sigma_m)),
            chi2=read_only(joined(one.chi2, two.chi2)),
            residual_px=read_only(joined(one.residual_px, two.residual_px)),
        ),
        ends_m=read_only(joined(first.ends_m, second.ends_m)),
        completed=read_only(np.concatenate([first.completed, second.completed])),
        slack_m=read_only(joined(first.slack_m, second.slack_m)),
        cover=read_only(joined(first.cover, second.cover)),
        cost=read_only(joined(first.cost, second.cost)),
    )


def _rows(placed: Placed, rows: Ints) -> Placed:
    return Placed(
        solved=rows_of(placed.solved, rows),
        ends_m=read_only(placed.ends_m[rows]),
        completed=read_only(placed.completed[rows]),
        slack_m=read_only(placed.slack_m[rows]),
        cover=read_only(placed.cover[rows]),
        cost=read_only(placed.cost[rows]),
    )
