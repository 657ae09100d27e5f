"""Products of several widths, or with a topology, in one look: each kind is looked for, the answers made one.

What one kind of part shows is known to the others: what lies where another product was recognised is no
refused candidate, no unexplained piece, and of two products in one place one stays.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from vision.colour import Colour
from vision.crossings import MIDDLE
from vision.default import locate_default
from vision.published import Observer
from vision.sizes import of_one_width
from vision.types import (
    Candidate,
    Crossing,
    Floats,
    Grey,
    PartModel,
    Plane,
    Refusal,
    Refused,
    Scene,
    Segments3D,
    StereoModel,
    Tuning,
    read_only,
)

ALONG = 0.97
"""Cosine from which two straight pieces may lie in one place."""
ASIDE = 0.6
"""They do when they are nearer than this share of their mean thickness, in the left picture."""
OVERLAP = 0.5
"""And when they share this much of the shorter one."""
THICK_SHARE = 0.82
"""Of two parts in one place the thick one is believed when its score is at least this share of the thin
one's: one flank of a thick rod and its highlight explain much as a thin one, a thin rod explains little as a
thick one. In mixed heaps it is 0.88 and more where the thick one is true (19 of 21), 0.75 and less where the
thin one is."""
LEAST_SIGMA_M = 0.0005
"""Depth of a crossing between kinds of parts is never known better."""


def locate_together(
    left_grey: Grey,
    right_grey: Grey,
    stereo_model: StereoModel,
    parts: tuple[PartModel, ...],
    tuning: Tuning,
    table: Plane | None = None,
    observe: Observer | None = None,
    colour_left: Colour | None = None,
) -> Scene:
    """One scene with the candidates of all products; parameters as for `vision.locate.locate`.

    Products that are straight and of one width are explained together (`vision.sizes`). A first answer is
    given only where all are: what another kind of part hides is not known before the end.

    Parameters
    ----------
    parts
        The first is the one that is asked for.
    """
    kinds = _kinds(parts)
    if len(kinds) == 1:
        (first, *among) = kinds[0]
        return locate_default(
            left_grey, right_grey, stereo_model, first, tuning, table, observe, colour_left, tuple(among)
        )

    def tell(stage: str, product: object) -> None:
        if observe is not None and stage != "first":
            observe(stage, product)

    scenes = [
        locate_default(
            left_grey, right_grey, stereo_model, first, tuning, table, tell, colour_left, tuple(among)
        )
        for first, *among in kinds
    ]
    return joined(scenes, parts)


def _kinds(parts: tuple[PartModel, ...]) -> list[list[PartModel]]:
    """Parts that can be looked for together; a part with a topology is a kind of its own."""
    kinds: list[list[PartModel]] = []
    for part in parts:
        for kind in kinds:
            if of_one_width(kind[0], (part,)):
                kind.append(part)
                break
        else:
            kinds.append([part])
    return kinds


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Lying:
    """A candidate where the left camera sees it. ``kind`` of the scene it comes from; ``pieces`` (E, 2, 3) m
    its straight pieces."""

    candidate: Candidate
    kind: int
    place: int
    pieces: Floats
    diameter_m: float


def joined(scenes: list[Scene], parts: tuple[PartModel, ...]) -> Scene:
    """Scenes of one pair of pictures as one; ``parts`` all products they were looked through for."""
    by_code = {part.code: part for part in parts}
    every = [
        _lying(candidate, kind, place, by_code[candidate.part_code])
        for kind, scene in enumerate(scenes)
        for place, candidate in enumerate(scene.candidates)
    ]
    known = [one for one in every if one.candidate.recognised]
    kept = [
        one
        for one in every
        if one.candidate.recognised
        or not any(one.kind != other.kind and _in_one_place(one, other) for other in known)
    ]
    why: dict[int, list[Refused]] = {id(one): [] for one in kept}
    for worse, better in _doubles(known):
        why[id(worse)].append(
            Refused(
                reason=Refusal.DUPLICATE,
                value=worse.candidate.score,
                limit=better.candidate.score,
                unit="1",
            )
        )
    known = [one for one in known if not why[id(one)]]
    between = [
        (upper, lower, meeting)
        for one, other in combinations(known, 2)
        if one.kind != other.kind
        for upper, lower, meeting in _meetings(one, other)
    ]
    for _, lower, meeting in between:
        if MIDDLE[0] < meeting.share < MIDDLE[1]:
            why[id(lower)].append(Refused(reason=Refusal.CROSSED, value=1.0, limit=0.0, unit="1"))
    changed = {id(one): _refused(one.candidate, why[id(one)]) for one in kept}
    order = sorted(kept, key=lambda one: _standing(changed[id(one)]))
    places = {(one.kind, one.place): n for n, one in enumerate(order)}
    crossings = [
        replace(crossing, above=places[kind, crossing.above], below=places[kind, crossing.below])
        for kind, scene in enumerate(scenes)
        for crossing in scene.crossings
        if (kind, crossing.above) in places and (kind, crossing.below) in places
    ]
    crossings += [
        Crossing(
            above=places[upper.kind, upper.place],
            below=places[lower.kind, lower.place],
            point=read_only(meeting.point),
            gap_m=meeting.gap_m,
            sure=meeting.sure,
        )
        for upper, lower, meeting in between
    ]
    first = scenes[0]
    return replace(
        first,
        candidates=tuple(changed[id(one)] for one in order),
        segments=_segments(scenes, known),
        crossings=tuple(crossings),
    )


def _doubles(known: list[_Lying]) -> Iterator[tuple[_Lying, _Lying]]:
    """Of two parts in one place: the one that is none, and the other.

    Two thin ones side by side show the flanks of a thick one, and two more.
    """
    for thick in known:
        inside = [
            thin
            for thin in known
            if thin.kind != thick.kind and thin.diameter_m < thick.diameter_m and _in_one_place(thin, thick)
        ]
        if any(not _in_one_place(one, other) for one, other in combinations(inside, 2)):
            yield thick, inside[0]
            continue
        for thin in inside:
            believed = thick.candidate.score >= THICK_SHARE * thin.candidate.score
            yield (thin, thick) if believed else (thick, thin)


def _lying(candidate: Candidate, kind: int, place: int, part: PartModel) -> _Lying:
    pieces = np.stack([candidate.start, candidate.end])[None]
    if part.topology is not None:
        pieces = candidate.nodes[part.topology.edges]
    return _Lying(candidate=candidate, kind=kind, place=place, pieces=pieces, diameter_m=part.diameter_m)


def _seen(points_m: Floats) -> Floats:
    """(..., 2) where the left camera sees points, at focal length one and without distortion."""
    return np.asarray(points_m[..., :2] / points_m[..., 2:], np.float64)


def _in_one_place(one: _Lying, other: _Lying) -> bool:
    """Whether the left camera sees two candidates in one place, by any of their straight pieces."""
    aside = ASIDE * 0.5 * (one.diameter_m + other.diameter_m)
    return any(_along(piece, like, aside) for piece in one.pieces for like in other.pieces)


def _along(piece: Floats, like: Floats, aside_m: float) -> bool:
    """Whether two pieces (2, 3) m lie along each other in the left picture."""
    a, b = _seen(piece), _seen(like)
    far_m = 0.25 * float(piece[:, 2].sum() + like[:, 2].sum())
    u, v = a[1] - a[0], b[1] - b[0]
    long_u, long_v = float(np.linalg.norm(u)), float(np.linalg.norm(v))
    if min(long_u, long_v) < 1e-9 or abs(float(u @ v)) < ALONG * long_u * long_v:
        return False
    normal = np.array([-v[1], v[0]]) / long_v
    if np.abs((a - b[0]) @ normal).mean() * far_m > aside_m:
        return False
    at = np.sort((a - b[0]) @ v / long_v)
    shared = min(float(at[1]), long_v) - max(float(at[0]), 0.0)
    return shared > OVERLAP * min(long_u, long_v)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Meeting:
    """Where one piece lies over another: ``share`` along the lower one; as in `vision.types.Crossing`."""

    share: float
    point: Floats
    gap_m: float
    sure: float


def _meetings(one: _Lying, other: _Lying) -> list[tuple[_Lying, _Lying, _Meeting]]:
    """Upper, lower and place of all crossings of two candidates in the left picture."""
    found = []
    for first in one.pieces:
        for second in other.pieces:
            shares = _cross(_seen(first), _seen(second))
            if shares is None:
                continue
            # depth along a straight piece is harmonic in the picture
            depth, under = (_depth(piece, at) for piece, at in ((first, shares[0]), (second, shares[1])))
            sigma = np.hypot(
                np.hypot(np.nan_to_num(one.candidate.sigma_m), np.nan_to_num(other.candidate.sigma_m)),
                LEAST_SIGMA_M,
            )
            over = depth < under
            upper, lower = (one, other) if over else (other, one)
            seen = _seen(first)
            ray = seen[0] + shares[0] * (seen[1] - seen[0])
            found.append(
                (
                    upper,
                    lower,
                    _Meeting(
                        share=shares[1] if over else shares[0],
                        point=min(depth, under) * np.append(ray, 1.0),
                        gap_m=abs(depth - under) - 0.5 * (one.diameter_m + other.diameter_m),
                        sure=float(abs(depth - under) / sigma),
                    ),
                )
            )
    return found


def _cross(a: Floats, b: Floats) -> tuple[float, float] | None:
    """Shares along two pieces of a plane (2, 2) where they cross; None where they do not."""
    u, v, w = a[1] - a[0], b[1] - b[0], b[0] - a[0]
    det = float(u[0] * v[1] - u[1] * v[0])
    if abs(det) < 1e-12:
        return None
    s, t = float(w[0] * v[1] - w[1] * v[0]) / det, float(w[0] * u[1] - w[1] * u[0]) / det
    return (s, t) if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0 else None


def _depth(piece: Floats, share: float) -> float:
    return float(1.0 / ((1 - share) / piece[0, 2] + share / piece[1, 2]))


def _refused(candidate: Candidate, more: list[Refused]) -> Candidate:
    """With further reasons; parts of other kinds that lie over it are counted with its own."""
    if not more:
        return candidate
    over = [why for why in (*candidate.refusals, *more) if why.reason is Refusal.CROSSED]
    rest = [why for why in (*candidate.refusals, *more) if why.reason is not Refusal.CROSSED]
    if over:
        rest.append(replace(over[0], value=sum(why.value for why in over)))
    return replace(candidate, refusals=tuple(rest))


def _standing(candidate: Candidate) -> int:
    """Offered ones first, then what is only covered or too steep now, then the rest."""
    return 0 if candidate.offered else (1 if candidate.recognised else 2)


def _segments(scenes: list[Scene], known: list[_Lying]) -> Segments3D:
    """All that was measured; what nobody explained only where no part of another kind does."""
    start, end, edge, residual = [], [], [], []
    for kind, scene in enumerate(scenes):
        of = scene.segments
        lone = np.isnan(of.residual_px)
        keep = np.ones(len(of.start), np.bool_)
        for row in np.flatnonzero(lone):
            piece = np.stack([of.start[row], of.end[row]])
            keep[row] = not any(
                _along(piece, like, ASIDE * one.diameter_m)
                for one in known
                if one.kind != kind
                for like in one.pieces
            )
        start.append(of.start[keep])
        end.append(of.end[keep])
        edge.append(of.edge[keep])
        residual.append(of.residual_px[keep])
    return Segments3D(
        start=read_only(np.concatenate(start)),
        end=read_only(np.concatenate(end)),
        edge=read_only(np.concatenate(edge)),
        residual_px=read_only(np.concatenate(residual)),
    )
