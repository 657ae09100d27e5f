"""The published node matching: Algorithm 1, two referents, the smooth function (section 3.2).

Each step is a function of its own. The graphs are those of the two rectified pictures; "position" is the row,
"depth" what the column difference says. A node of the left graph is called v, one of the right graph w.

The paper leaves open which two matched nodes serve as referents, and in which order the undecided nodes are
settled. Here the referents are the two agreed nodes nearest to v, because perspective changes distances and
angles least over short ways; and the pair that fits its referents best is settled first, so the result does
not depend on how the nodes happen to be numbered.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vision.stereo import Rectification, rectified_depth
from vision.types import Bools, Floats, Graph, Ints, Matches, read_only

REFERENTS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Gates:
    """The intervals a person sets.

    ``depth_m`` [DMin, DMax] of z in the raw left camera frame; ``position_px`` [PMin, PMax] of the row in the
    left minus the row in the right picture; ``angle_rad`` the optional threshold on the angle, None without.
    """

    depth_m: tuple[float, float]
    position_px: tuple[float, float]
    angle_rad: float | None = None


def match(left: Graph, right: Graph, rect: Rectification, gates: Gates) -> Matches:
    """Which node of the left graph is which of the right one.

    Algorithm 1, then the nodes with a single candidate on both sides agree, then each node with several
    candidates is settled by distance and angle to two agreed ones; matched nodes are withdrawn at once.

    Returns
    -------
    Matches
        ``cost_px`` is the disagreement in distance and angle with the referents (px), or the row difference
        for nodes that had one candidate; ``ambiguous`` counts left nodes with several candidates after
        Algorithm 1, ``unmatched`` left nodes without a partner in the end.
    """
    left_order, right_order = _by_position(left.points), _by_position(right.points)
    left_px, right_px = left.points[left_order], right.points[right_order]
    labelled = labels(left_px, right_px, rect, gates)
    pairs, costs = _settle(left_px, right_px, labelled, gates.angle_rad)
    left_index = left_order[pairs[:, 0]]
    order = np.argsort(left_index, kind="stable")
    return Matches(
        left=read_only(left_index[order]),
        right=read_only(right_order[pairs[:, 1]][order]),
        cost_px=read_only(costs[order]),
        unmatched=len(left_px) - len(pairs),
        ambiguous=int(np.count_nonzero(labelled.sum(axis=1) > 1)),
    )


def labels(left_px: Floats, right_px: Floats, rect: Rectification, gates: Gates) -> Bools:
    """Algorithm 1: entry (v, w) is True when w gets the label of v (section 3.2).

    Parameters
    ----------
    left_px, right_px : (N, 2), (M, 2) float
        Rectified pixels of the nodes.

    Returns
    -------
    (N, M) bool
        DMin < D < DMax and PMin < P < PMax, D the depth of the pair in m, P its row difference in px.
    """
    rectified = rectified_depth(left_px[:, 0][:, None], right_px[:, 0][None, :], rect)
    # z of the raw left camera: the third row of the rotation back, along the ray of v
    rays = np.column_stack([(left_px - rect.left_centre_px) / rect.focal_px, np.ones(len(left_px))])
    depth = rectified * (rays @ rect.rect_from_left[:, 2])[:, None]
    position = left_px[:, 1][:, None] - right_px[:, 1][None, :]
    (near, far), (low, high) = gates.depth_m, gates.position_px
    return np.asarray((near < depth) & (depth < far) & (low < position) & (position < high), np.bool_)


def agreed(labelled: Bools) -> Ints:
    """Pairs (K, 2) of nodes that are each other's only candidate: the matched nodes of section 3.2."""
    single = labelled & (labelled.sum(axis=1) == 1)[:, None] & (labelled.sum(axis=0) == 1)[None, :]
    return np.argwhere(single).astype(np.int64)


def withdraw(labelled: Bools, pairs: Ints) -> Bools:
    """The smooth function: the table (N, M) without the labels of nodes already matched (section 3.2)."""
    left = labelled.copy()
    left[pairs[:, 0], :] = False
    left[:, pairs[:, 1]] = False
    return left


def referents(left_px: Floats, node: int, matched: Ints) -> Ints:
    """The two matched pairs (2, 2) whose left nodes are nearest to a left node (section 3.2).

    Fewer rows when there are not enough matched nodes at a distance from it.
    """
    away = np.linalg.norm(left_px[matched[:, 0]] - left_px[node], axis=1)
    usable = np.flatnonzero(away > 0)
    nearest = usable[np.argsort(away[usable], kind="stable")[:REFERENTS]]
    return matched[nearest]


def disagreement_px(
    point: Floats, candidates: Floats, left_pair: Floats, right_pair: Floats, angle_rad: float | None
) -> Floats:
    """How badly each candidate repeats a node's distance and angle to the referents (section 3.2).

    Parameters
    ----------
    point : (2,) float
        The left node.
    candidates : (K, 2) float
        Right nodes it may be.
    left_pair, right_pair : (2, 2) float
        The two referents in the left and in the right picture.
    angle_rad : float or None
        With a threshold, an angle that differs by less counts as the same (perspective may change it so much)
        and a candidate whose angle differs by more is out. Without, every difference counts.

    Returns
    -------
    (K,) float
        Summed difference of the two distances, plus the difference of the angle between the referents as seen
        from the node times the node's mean distance; px. Infinite where a candidate is out.
    """
    own_distance, own_angle = _distance_and_angle(point[None, :], left_pair)
    distance, angle = _distance_and_angle(candidates, right_pair)
    turned = np.abs((angle - own_angle + np.pi) % (2 * np.pi) - np.pi)
    apart = np.abs(distance - own_distance).sum(axis=1)
    if angle_rad is None:
        return np.asarray(apart + turned * own_distance.mean(), np.float64)
    return np.where(turned <= angle_rad, apart, np.inf)


def _distance_and_angle(points: Floats, pair: Floats) -> tuple[Floats, Floats]:
    """Distances (K, 2) to two referents and the signed angle (K,) between them, seen from points.

    The sign tells a node from its mirror image across the line of the referents.
    """
    ways = pair[None, :, :] - points[:, None, :]
    first, second = ways[:, 0], ways[:, 1]
    cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return np.linalg.norm(ways, axis=2), np.arctan2(cross, (first * second).sum(axis=1))


def _settle(
    left_px: Floats, right_px: Floats, labelled: Bools, angle_rad: float | None
) -> tuple[Ints, Floats]:
    """Pairs (P, 2) and their costs (P,), until nothing more can be decided."""
    matched = np.zeros((0, 2), np.int64)
    costs: list[float] = []
    table = labelled
    while True:
        sure = agreed(table)
        while len(sure):
            matched = np.concatenate([matched, sure])
            costs += np.abs(left_px[sure[:, 0], 1] - right_px[sure[:, 1], 1]).tolist()
            table = withdraw(table, sure)
            sure = agreed(table)
        best = _best_undecided(left_px, right_px, table, matched, angle_rad)
        if best is None:
            return matched, np.array(costs, np.float64)
        pair, cost = best
        matched = np.concatenate([matched, pair])
        costs.append(cost)
        table = withdraw(table, pair)


def _best_undecided(
    left_px: Floats, right_px: Floats, table: Bools, matched: Ints, angle_rad: float | None
) -> tuple[Ints, float] | None:
    """The open pair (1, 2) that fits its referents best and its cost in px; None when none can be judged."""
    best: tuple[Ints, float] | None = None
    for node in np.flatnonzero(table.any(axis=1)).tolist():
        two = referents(left_px, node, matched)
        if len(two) < REFERENTS:
            continue
        open_to = np.flatnonzero(table[node])
        costs = disagreement_px(
            left_px[node], right_px[open_to], left_px[two[:, 0]], right_px[two[:, 1]], angle_rad
        )
        least = int(np.argmin(costs))
        if np.isfinite(costs[least]) and (best is None or costs[least] < best[1]):
            best = np.array([[node, open_to[least]]], np.int64), float(costs[least])
    return best


def _by_position(points_px: Floats) -> Ints:
    """Node numbers in reading order, so that ties are settled by place and not by number."""
    return np.lexsort((points_px[:, 0], points_px[:, 1])).astype(np.int64)
