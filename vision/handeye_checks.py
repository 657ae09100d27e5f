"""Hand-eye from start to verdict: what the poses can tell, the fit, what it is good for, and what is wrong.

Nothing is repaired here: what is wrong with a session gets its name (`vision.handeye_trouble`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from vision import handeye_trouble, transforms
from vision.handeye import (
    ClosedForm,
    HandEye,
    Mount,
    Sighting,
    camera_from_board,
    closed_forms,
    mount_from_held,
)
from vision.handeye_fit import Fit, Noise, board_pose, fit, pose_residuals_px
from vision.handeye_trouble import (
    LEAST_POSES,
    WRONG_RMS_PX,
    Finding,
    Motion,
    Trouble,
    motion_of,
    weak,
)
from vision.types import Floats, StereoModel, Transform, read_only

WRONG_POSE_TIMES, WRONG_POSE_PX = 4.0, 0.6
"""A pose that leaves this many times the median of the others and this much is wrong."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Told:
    """One closed form with what it leaves, px; ``found`` None where it gave up."""

    form: ClosedForm
    rms_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verdict:
    """A session's outcome. ``fit`` None where nothing could be fitted.

    ``used`` places of the poses the fit rests on; ``pose_px`` (N,) of all poses, NaN where a board has no
    pose; ``held_out_m`` (N,) how far the board of each pose lies from where all others say it is, its corners
    on average; ``area_m`` (K,) deviation of points at the pick area when single poses are left out
    (jackknife), the headline figure; ``findings`` empty for a session that can be used.
    """

    mount: Mount
    motion: Motion
    forms: tuple[Told, ...]
    fit: Fit | None
    used: tuple[int, ...]
    pose_px: Floats
    held_out_m: Floats
    area_m: Floats
    findings: tuple[Finding, ...]

    @property
    def good(self) -> bool:
        """Whether the result may be used."""
        return self.fit is not None and not self.findings


def calibrate(
    sightings: Sequence[Sighting],
    stereo: StereoModel,
    mount: Mount,
    area_m: Floats,
    noise: Noise | None = None,
) -> Verdict:
    """The whole way from poses and corners to a verdict.

    Parameters
    ----------
    area_m : (K, 3) float
        Points of the pick area in the left camera's frame: where the error counts. None, (0, 3): no pose is
        left out to tell it, which takes most of the time.
    """
    noise = noise or Noise()
    count = len(sightings)
    motion = motion_of([s.base_from_tool for s in sightings])
    findings = list(weak(motion, count))
    if findings:
        return _nothing(mount, motion, count, findings)
    pair = handeye_trouble.pairs(sightings, stereo)
    if pair is not None:
        return _nothing(mount, motion, count, [pair])
    boards = [board_pose(s, stereo) for s in sightings]
    seen = [k for k, board in enumerate(boards) if board is not None]
    if len(seen) < LEAST_POSES:
        few = Finding(trouble=Trouble.TOO_FEW, value=len(seen), limit=LEAST_POSES, unit="1")
        return _nothing(mount, motion, count, [few])
    mirrored = handeye_trouble.mirrored([board for board in boards if board is not None])
    if mirrored is not None:
        findings.append(mirrored)
    looked = [sightings[k] for k in seen]
    lying = [boards[k] for k in seen if boards[k] is not None]
    poses = [board for board in lying if board is not None]
    helds = [mount_from_held(s, mount) for s in looked]
    forms = tuple(
        Told(form=form, rms_px=_rms(looked, stereo, mount, form.found)) for form in closed_forms(helds, poses)
    )
    start = _start(looked, poses, stereo, mount)
    if start is None:
        return replace(
            _nothing(mount, motion, count, findings or [handeye_trouble.no_fit(float("inf"))]), forms=forms
        )
    first = fit(looked, stereo, mount, start, noise)
    agreed, wrong = _agreeing(looked, stereo, mount, first, noise)
    result = first if not wrong else fit([looked[k] for k in agreed], stereo, mount, start, noise)
    scales = 2 if any(len(s.right_px) for s in looked) else 1
    scaled = fit([looked[k] for k in agreed], stereo, mount, result.found, noise, robust=False, scales=scales)
    findings += _misunderstood(looked, poses, stereo, mount, result, scaled, len(agreed))
    if not any(f.trouble in _UNFIT for f in findings):
        findings += [
            Finding(
                trouble=Trouble.WRONG_POSE,
                value=px,
                limit=limit,
                unit="px",
                poses=(seen[k],),
            )
            for k, px, limit in wrong
        ]
        findings += handeye_trouble.scales(scaled)
    pose_px = np.full(count, np.nan)
    pose_px[seen] = pose_residuals_px(looked, stereo, mount, result.found)
    held_out, area = _left_out(looked, poses, agreed, stereo, mount, result, noise, area_m)
    held_all = np.full(count, np.nan)
    held_all[seen] = held_out
    return Verdict(
        mount=mount,
        motion=motion,
        forms=forms,
        fit=replace(
            result,
            board_scale=scaled.board_scale,
            rig_scale=scaled.rig_scale,
            board_scale_sigma=scaled.board_scale_sigma,
            rig_scale_sigma=scaled.rig_scale_sigma,
        ),
        used=tuple(seen[k] for k in agreed),
        pose_px=read_only(pose_px),
        held_out_m=read_only(held_all),
        area_m=read_only(area),
        findings=tuple(findings),
    )


_UNFIT: Final = frozenset({Trouble.NO_FIT, Trouble.INVERTED, Trouble.OTHER_MOUNT})


def _nothing(mount: Mount, motion: Motion, count: int, findings: list[Finding]) -> Verdict:
    return Verdict(
        mount=mount,
        motion=motion,
        forms=(),
        fit=None,
        used=(),
        pose_px=read_only(np.full(count, np.nan)),
        held_out_m=read_only(np.full(count, np.nan)),
        area_m=read_only(np.zeros(0)),
        findings=tuple(findings),
    )


def _rms(sightings: Sequence[Sighting], stereo: StereoModel, mount: Mount, found: HandEye | None) -> float:
    if found is None:
        return float("nan")
    counts = np.array([s.corners for s in sightings])
    each = pose_residuals_px(sightings, stereo, mount, found)
    return float(np.sqrt(np.sum(each**2 * counts) / counts.sum()))


def _start(
    sightings: Sequence[Sighting], boards: Sequence[Transform], stereo: StereoModel, mount: Mount
) -> HandEye | None:
    """The closed form that the median pose likes best, over all poses and over some that leave a few out: one
    wrong pose spoils every closed form it is part of."""
    helds = [mount_from_held(s, mount) for s in sightings]
    count = len(helds)
    chosen = [list(range(count)), list(range(0, count, 2)), list(range(1, count, 2))]
    chosen += [[k for k in range(count) if k % 5 != left] for left in range(5)]
    best: tuple[float, HandEye] | None = None
    for places in chosen:
        if len(places) < 3:
            continue
        for form in closed_forms([helds[k] for k in places], [boards[k] for k in places]):
            if form.found is None:
                continue
            cost = float(np.median(pose_residuals_px(sightings, stereo, mount, form.found)))
            if np.isfinite(cost) and (best is None or cost < best[0]):
                best = (cost, form.found)
    return None if best is None else best[1]


def _agreeing(
    sightings: Sequence[Sighting], stereo: StereoModel, mount: Mount, first: Fit, noise: Noise
) -> tuple[list[int], list[tuple[int, float, float]]]:
    """Places of the poses that agree, and those that do not with what they leave and the limit, worst first.

    One at a time, and what is left is fitted anew: a wrong pose pulls its neighbours.
    """
    wrong: list[tuple[int, float, float]] = []
    agreed, now = list(range(len(sightings))), first
    while len(agreed) > LEAST_POSES - 1:
        each = pose_residuals_px([sightings[k] for k in agreed], stereo, mount, now.found)
        limit = max(WRONG_POSE_PX, WRONG_POSE_TIMES * float(np.median(each)))
        worst = int(np.argmax(each))
        if each[worst] <= limit or len(wrong) >= len(sightings) // 3:
            break
        place = agreed.pop(worst)
        now = fit([sightings[k] for k in agreed], stereo, mount, now.found, noise)
        left = float(pose_residuals_px([sightings[place]], stereo, mount, now.found)[0])
        wrong.append((place, left, limit))
    return agreed, wrong


def _misunderstood(
    sightings: Sequence[Sighting],
    boards: Sequence[Transform],
    stereo: StereoModel,
    mount: Mount,
    result: Fit,
    scaled: Fit,
    agreed: int,
) -> list[Finding]:
    """Where nothing fits as told, what does: poses the other way round, the other mounting."""
    if result.rms_px <= WRONG_RMS_PX and agreed > len(sightings) // 2:
        return []
    if scaled.rms_px <= 0.5 * WRONG_RMS_PX:  # only the sizes are wrong
        return []
    turned = [replace(s, base_from_tool=transforms.invert(s.base_from_tool)) for s in sightings]
    # the other mounting is the inverted poses, so the two cannot be told apart by numbers: both are named
    start = _start(turned, boards, stereo, mount)
    if start is not None:
        tried = fit(turned, stereo, mount, start, Noise())
        if tried.rms_px < WRONG_RMS_PX:
            return [
                Finding(trouble=Trouble.OTHER_MOUNT, value=result.rms_px, limit=WRONG_RMS_PX, unit="px"),
                Finding(trouble=Trouble.INVERTED, value=result.rms_px, limit=WRONG_RMS_PX, unit="px"),
            ]
    return [handeye_trouble.no_fit(result.rms_px)]


def _left_out(
    sightings: Sequence[Sighting],
    boards: Sequence[Transform],
    agreed: Sequence[int],
    stereo: StereoModel,
    mount: Mount,
    result: Fit,
    noise: Noise,
    area_m: Floats,
) -> tuple[Floats, Floats]:
    """Each pose left out once: how far its board then lies from where the others have it (N,), and the spread
    of the pick area's points (K,), the jackknife's deviation (Efron and Stein 1981)."""
    held_out = np.full(len(sightings), np.nan)
    if not len(area_m):
        return held_out, np.zeros(0)
    moved = []
    for place, sighting in enumerate(sightings):
        if place in agreed:
            rest = [sightings[k] for k in agreed if k != place]
            found = fit(rest, stereo, mount, result.found, noise, robust=False).found
            moved.append(transforms.apply(found.mount_from_camera, area_m))
        else:
            found = result.found
        points = sighting.board_left_m if len(sighting.left_px) else sighting.board_right_m
        told = transforms.apply(camera_from_board(found, mount_from_held(sighting, mount)), points)
        seen = transforms.apply(boards[place], points)
        held_out[place] = float(np.linalg.norm(told - seen, axis=1).mean())
    if len(moved) < 2:
        return held_out, np.zeros(0)
    cloud = np.stack(moved)
    off = np.sum((cloud - cloud.mean(axis=0)) ** 2, axis=2)
    spread = np.sqrt((len(moved) - 1) / len(moved) * off.sum(axis=0))
    return held_out, np.asarray(spread, dtype=np.float64)
