"""Which fits are parts: each edge explained once, nothing in the pictures against it, refusals with numbers.

A fit can be wrong in three ways, each of which leaves its mark: an arm is not there (its edge is not seen,
or its inside is background), an arm goes on past its end (its flanks continue and its end face is not seen),
or somebody better explains the same edges. Nothing can hide a part by showing the table, so background
inside counts more than an edge that is not seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from vision.retrieve import tilt_rad
from vision.shape_evidence import by_group, claimed
from vision.shape_fit import Fit
from vision.shape_model import ShapeModel
from vision.stereo import Rectification
from vision.types import (
    Bools,
    Candidate,
    Floats,
    PartModel,
    Plane,
    Refusal,
    Refused,
    Topology,
    Tuning,
    read_only,
)  # fmt: skip

LEAST_WORTH: Final = 0.42
"""Of the sum in `worth`. A part half hidden shows about half of its edge."""
DENIED_WEIGHT: Final = 4.0
BARE_WEIGHT: Final = 2.0
TIPS_WEIGHT: Final = 0.1
LEAST_ARM: Final = 0.25
MOST_DENIED_ARM: Final = 0.2
"""Share of an arm's edge that should be in the open and is not there."""
MOST_BARE: Final = 0.06
MOST_BARE_ARM: Final = 0.15
LEAST_TIP: Final = 0.25
MOST_BEYOND: Final = 0.65
STRAIGHT_DRIFT: Final = 0.08
LEAST_OWN: Final = 0.6
"""Share of what is seen that nobody better has explained."""
WIDTH_SHARE: Final = (0.5, 1.45)
"""Seen width over stated width: metal's flanks are dark, light blooms."""
FULL_WIDTH: Final = 0.88
LESS_WIDTH: Final = 0.18
LEAST_IN_PICTURE: Final = 0.95
MIDDLE: Final = (1.0 / 3.0, 2.0 / 3.0)
HIDDEN_WIDTHS: Final = 0.5
"""A part that crosses at a right angle hides a width, of which blur gives a pixel back at either side."""
SAME_GAP_WIDTHS: Final = 0.4
OVER_WIDTHS: Final = 0.7
OVER_DEPTH_WIDTHS: Final = 0.4
"""One part is over another where it is nearer by this: parts that touch are a width apart."""
VAGUE_M: Final = 0.004
"""Doubt about the place, one standard deviation, from which a part is not offered: a gripper opens little
more than that on either side."""
RELATED_SAMPLES: Final = 4.0
"""Neighbouring samples of an edge err together."""
BIAS_PX: Final = 0.1
BIAS_PER_GROWN: Final = 0.2
"""What shading does to the edges of one view against the other: a little always, more at dark flanks."""
MOST_REFUSED: Final = 5
LEAST_TOLD: Final = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sigma:
    """Standard deviations of the centre, worst direction, and of the axis."""

    centre_m: float
    axis_rad: float


def choose(
    fits: list[Fit],
    shape: ShapeModel,
    part: PartModel,
    topology: Topology,
    tuning: Tuning,
    table: Plane,
    rect: Rectification,
) -> tuple[Candidate, ...]:
    """Every part found, offered ones first and of those the freest; then refused ones.

    Parameters
    ----------
    fits
        Best first.
    shape
        The sampled part that the fits' evidence is of.
    """
    taken: list[Fit] = []
    found: list[tuple[float, Fit, Candidate]] = []
    told = 0
    everything = np.ones((2, len(shape.points)), np.bool_)
    worths = [worth(fit, shape, everything) for fit in fits]
    for rank in np.argsort(-np.array(worths), kind="stable").tolist():
        fit = fits[rank]
        own = ~claimed(fit.evidence, [one.evidence for one in taken])
        reasons = [*_reasons(fit, own, shape), *_outside(fit, topology, part, tuning, table)]
        if taken:
            reasons += _narrower(fit, taken[0], shape)
        is_near = not reasons or fit.evidence.seen.mean() >= LEAST_TOLD
        if not is_near or (reasons and told >= MOST_REFUSED):
            continue
        sigma = _sigma(fit, topology, rect)
        if sigma.centre_m > VAGUE_M:
            reasons.append(Refused(reason=Refusal.AMBIGUOUS, value=sigma.centre_m, limit=VAGUE_M, unit="m"))
        if reasons:
            told += 1
        else:
            taken.append(fit)
        nodes = fit.at(topology.points)
        first, last = nodes[topology.axis[0]], nodes[topology.axis[1]]
        tilt = tilt_rad((last - first) / np.linalg.norm(last - first), table)
        if tilt > tuning.max_tilt_rad:
            reasons.append(Refused(reason=Refusal.TILT, value=tilt, limit=tuning.max_tilt_rad, unit="rad"))
        score = float(np.clip(worths[rank], 0.0, 1.0))
        if score < tuning.min_score:
            reasons.append(Refused(reason=Refusal.LOW_SCORE, value=score, limit=tuning.min_score, unit="1"))
        found.append((score, fit, _candidate(fit, nodes, topology, part, score, sigma, tuple(reasons))))
    found = [
        (score, fit, _crossed(candidate, fit, taken, shape, topology) if fit in taken else candidate)
        for score, fit, candidate in found
    ]
    found.sort(key=lambda item: (not item[2].offered, not item[2].recognised, -item[0]))
    return tuple(candidate for _, _, candidate in found)


def _candidate(
    fit: Fit,
    nodes: Floats,
    topology: Topology,
    part: PartModel,
    score: float,
    sigma: _Sigma,
    reasons: tuple[Refused, ...],
) -> Candidate:
    start, end = nodes[topology.axis[0]].copy(), nodes[topology.axis[1]].copy()
    length_m = float(np.linalg.norm(end - start))
    return Candidate(
        part_code=part.code,
        start=read_only(start),
        end=read_only(end),
        centre=read_only(0.5 * (start + end)),
        axis=read_only((end - start) / length_m),
        length_m=length_m,
        nodes=read_only(nodes),
        score=score,
        residual_px=fit.spread_px,
        refusals=reasons,
        sigma_m=sigma.centre_m,
        sigma_rad=sigma.axis_rad,
    )


def worth(fit: Fit, shape: ShapeModel, own: Bools) -> float:
    """How well both pictures bear a fit out, at most 1: the share of the edge that is seen and that nobody
    better explains (``own``), less what speaks against it: edge that should be in the open and is not there,
    background inside, end faces not seen, and a place where parts rarely lie."""
    denied = float(fit.evidence.denied.mean())
    bare = 1.0 - float(fit.evidence.body.mean())
    tips = by_group(fit.evidence.seen, shape.tip, 2 * shape.bars).max(axis=0)
    unseen = float(np.mean(tips[~np.isnan(tips)] < LEAST_TIP)) if np.any(~np.isnan(tips)) else 0.0
    seen = float((fit.evidence.seen & own).mean())
    return seen - DENIED_WEIGHT * denied - BARE_WEIGHT * bare - TIPS_WEIGHT * unseen - fit.unlikely


def _reasons(fit: Fit, own: Bools, shape: ShapeModel) -> list[Refused]:
    """What speaks against a fit being a part, by the pictures alone."""
    seen = fit.evidence.seen
    share = float((seen & own).sum() / max(1, seen.sum()))
    reasons = []

    def limited(reason: Refusal, value: float, limit: float, too_low: bool) -> None:
        if (value < limit) if too_low else (value > limit):
            reasons.append(Refused(reason=reason, value=value, limit=limit, unit="1"))

    limited(Refusal.DUPLICATE, share, LEAST_OWN, True)
    limited(Refusal.EDGE, float(fit.evidence.in_picture.min()), LEAST_IN_PICTURE, True)
    limited(Refusal.LOW_SCORE, worth(fit, shape, own), LEAST_WORTH, True)
    arms = by_group(seen & own, shape.arm, shape.arms).mean(axis=0)
    limited(Refusal.TOPOLOGY, float(np.nanmin(arms)), LEAST_ARM, True)
    denied = by_group(fit.evidence.denied, shape.arm, shape.arms).mean(axis=0)
    limited(Refusal.TOPOLOGY, float(np.nanmax(denied)), MOST_DENIED_ARM, False)
    bare = 1.0 - float(fit.evidence.body.mean())
    limited(Refusal.TOPOLOGY, bare, MOST_BARE, False)
    bare_arms = 1.0 - by_group(fit.evidence.body, shape.body_arm, shape.arms).mean(axis=0)
    limited(Refusal.TOPOLOGY, float(np.nanmax(bare_arms)), MOST_BARE_ARM, False)
    limited(Refusal.TOPOLOGY, _longer(fit, shape), MOST_BEYOND, False)
    low, high = WIDTH_SHARE
    width = _width_share(fit, shape)
    limited(Refusal.WIDTH, width, low, True)
    limited(Refusal.WIDTH, width, high, False)
    return reasons


def _width_share(fit: Fit, shape: ShapeModel) -> float:
    """Seen width over stated width."""
    return 1.0 + 2.0 * fit.grown_px / _width_px(fit, shape)


def _narrower(fit: Fit, surest: Fit, shape: ShapeModel) -> list[Refused]:
    """Where the surest part shows its full width, so its flanks are not dark, the others must too."""
    full, width = _width_share(surest, shape), _width_share(fit, shape)
    limit = full - LESS_WIDTH
    if full < FULL_WIDTH or width >= limit:
        return []
    return [Refused(reason=Refusal.WIDTH, value=width, limit=limit, unit="1")]


def _longer(fit: Fit, shape: ShapeModel) -> float:
    """Largest share of both flanks that go on past an end whose own face is not seen.

    What hides an end face has edges of its own direction there; flanks that go on right behind it, if only
    for a width, are the part's own.
    """
    ends = 2 * shape.bars
    tips = by_group(fit.evidence.seen, shape.tip, ends).max(axis=0)
    past = by_group(fit.evidence.beyond, shape.beyond_end, ends).min(axis=0)
    near = by_group(fit.evidence.beyond, np.where(shape.beyond_next, shape.beyond_end, -1), ends).min(axis=0)
    is_face = ~np.isnan(tips)
    on = np.where(is_face, np.fmax(past, near), past)
    shown = is_face & (np.nan_to_num(tips) >= LEAST_TIP)
    on = np.where(shown, 0.0, np.nan_to_num(on))
    for end in np.flatnonzero(on > MOST_BEYOND).tolist():
        if _drift(fit, shape, end) > STRAIGHT_DRIFT:
            on[end] = 0.0
    return float(np.max(on, initial=0.0))


def _drift(fit: Fit, shape: ShapeModel, end: int) -> float:
    """How much flanks past an end lean against the part's own, px per px, in the straighter view.

    Another part may happen to lie there; it is rarely parallel.
    """
    mine = np.flatnonzero(shape.beyond_end == end)
    first = shape.beyond[mine[0]]
    normal = shape.beyond_normals[mine[0]]
    side = np.sign(shape.beyond_normals[mine] @ normal)
    along_px = np.linalg.norm((shape.beyond[mine] - first) @ np.array([[-normal[1]], [normal[0]]]), axis=1)
    along_px *= _width_px(fit, shape) / shape.width_m
    leans = []
    for seen, off_px in zip(fit.evidence.beyond, fit.evidence.beyond_px, strict=True):
        use = seen[mine]
        if np.ptp(along_px[use]) > 0:
            leans.append(abs(float(np.polyfit(along_px[use], (side * off_px[mine])[use], 1)[0])))
    return min(leans, default=0.0)


def _width_px(fit: Fit, shape: ShapeModel) -> float:
    """How wide the part's arms are in the left picture."""
    pixel, at = fit.evidence.pixel[0], shape.points
    a, b = int(np.argmin(at @ [1.0, 0.3])), int(np.argmax(at @ [1.0, 0.3]))
    return float(shape.width_m * np.linalg.norm(pixel[a] - pixel[b]) / np.linalg.norm(at[a] - at[b]))


def _outside(fit: Fit, topology: Topology, part: PartModel, tuning: Tuning, table: Plane) -> list[Refused]:
    """Nodes out of the depth range, or out of the height range where only a table is known."""
    nodes = fit.at(topology.points)
    if tuning.depth_m is not None:
        values, (low, high) = nodes[:, 2], tuning.depth_m
    else:
        values, (low, high) = nodes @ table.normal + table.offset_m, tuning.height_m
        low, high = low - part.diameter_m, high + part.diameter_m
    if values.min() < low:
        return [Refused(reason=Refusal.DEPTH, value=float(values.min()), limit=low, unit="m")]
    if values.max() > high:
        return [Refused(reason=Refusal.DEPTH, value=float(values.max()), limit=high, unit="m")]
    return []


def _crossed(
    candidate: Candidate, fit: Fit, taken: list[Fit], shape: ShapeModel, topology: Topology
) -> Candidate:
    """The candidate, refused as crossed where its edge is missing in the middle of its axis."""
    hidden = _hidden_widths(fit, [one for one in taken if one is not fit], shape, topology)
    if hidden <= HIDDEN_WIDTHS:
        return candidate
    reason = Refused(reason=Refusal.CROSSED, value=hidden, limit=HIDDEN_WIDTHS, unit="1")
    return replace(candidate, refusals=(*candidate.refusals, reason))


def _over_others(fit: Fit, others: list[Fit], shape: ShapeModel, view: int) -> Bools:
    """(P,) samples before which a part found lies lower: its own brightness, not it, takes the edge away."""
    over = np.zeros(len(shape.points), np.bool_)
    mine = fit.evidence.pixel[view]
    depth = fit.at(shape.points)[:, 2]
    for other in others:
        ends = other.at(shape.lines[:, :4].reshape(-1, 2))[:, 2].reshape(-1, 2)
        for line, (near, far) in zip(other.evidence.lines[view], ends, strict=True):
            way = line[1] - line[0]
            along = np.clip((mine - line[0]) @ way / (way @ way), 0.0, 1.0)
            off = np.linalg.norm(mine - line[0] - along[:, None] * way, axis=1)
            beside = off < OVER_WIDTHS * _width_px(other, shape)
            over |= beside & (depth < near + along * (far - near) - OVER_DEPTH_WIDTHS * shape.width_m)
    return over


def _hidden_widths(fit: Fit, others: list[Fit], shape: ShapeModel, topology: Topology) -> float:
    """Longest stretch of the axis' middle third where edge is missing, in widths, in the better view."""
    a, b = topology.points[topology.axis[0], :2], topology.points[topology.axis[1], :2]
    length = float(np.linalg.norm(b - a))
    way = (b - a) / length
    off = shape.points - a
    along, aside = off @ way, np.abs(off @ np.array([-way[1], way[0]]))
    near = (along > MIDDLE[0] * length) & (along < MIDDLE[1] * length) & (aside < 0.8 * shape.width_m)
    order = np.flatnonzero(near)[np.argsort(along[near])]
    longest = []
    for view in (0, 1):
        seen = fit.evidence.faint[view] | _over_others(fit, others, shape, view)
        missing = along[order[~seen[order]]]
        # both flanks in one row: a place is hidden where either is, and goes on to the next if that is near
        cuts = np.flatnonzero(np.diff(missing) > SAME_GAP_WIDTHS * shape.width_m) + 1
        runs = [run for run in np.split(missing, cuts) if len(run) > 1]
        longest.append(max((float(run[-1] - run[0]) for run in runs), default=0.0))
    return min(longest) / shape.width_m


def _sigma(fit: Fit, topology: Topology, rect: Rectification) -> _Sigma:
    """Standard deviations from the residuals, and from what shading may do to one view against the other."""
    covariance = np.linalg.pinv(fit.matrix)[:6, :6] * RELATED_SAMPLES * fit.spread_px**2
    nodes = fit.at(topology.points)
    first, last = nodes[topology.axis[0]], nodes[topology.axis[1]]
    axis = (last - first) / np.linalg.norm(last - first)
    centre = 0.5 * (first + last)
    arm = centre - fit.middle_m
    cross = np.array([[0.0, -arm[2], arm[1]], [arm[2], 0.0, -arm[0]], [-arm[1], arm[0], 0.0]])
    moves = np.hstack([np.eye(3), -cross])
    place = float(np.linalg.eigvalsh(moves @ covariance @ moves.T)[-1])
    across = np.eye(3) - np.outer(axis, axis)
    turn = float(np.linalg.eigvalsh(across @ covariance[3:, 3:] @ across)[-1])
    bias_px = BIAS_PX + BIAS_PER_GROWN * abs(fit.grown_px)
    depth_m = bias_px * np.sqrt(2.0) * centre[2] ** 2 / (rect.focal_px * rect.baseline_m)
    return _Sigma(
        centre_m=float(np.sqrt(max(place, 0.0) + depth_m**2)),
        axis_rad=float(np.sqrt(max(turn, 0.0) + (depth_m / np.linalg.norm(last - first)) ** 2)),
    )
