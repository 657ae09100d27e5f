"""Hand-eye: the camera is found from both mountings, and what is wrong with a session is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cell.commission.hand_eye import area_points
from tests.fakes import boardrig
from tests.fakes.boardrig import Session
from vision import transforms
from vision.handeye import Mount
from vision.handeye_checks import Verdict, calibrate
from vision.handeye_trouble import Trouble, motion_of, weak

AREA = area_points(boardrig.stereo(), 0.4)
MOUNTS: tuple[Mount, ...] = ("fixed", "tool")


@pytest.fixture(scope="module", params=MOUNTS)
def session(request: pytest.FixtureRequest) -> Session:
    mount: Mount = request.param
    return boardrig.made(mount)


NOWHERE = np.zeros((0, 3))


def solved(session: Session) -> Verdict:
    """Without the pick area's error, which takes most of the time."""
    return calibrate(session.sightings, session.stereo, session.mount, NOWHERE)


def troubles(verdict: Verdict) -> set[Trouble]:
    return {finding.trouble for finding in verdict.findings}


def test_the_camera_is_found_and_the_error_foretold(session: Session) -> None:
    verdict = calibrate(session.sightings, session.stereo, session.mount, AREA)
    assert verdict.good
    assert verdict.fit is not None
    errors = boardrig.errors_mm(verdict.fit.found, session.truth, AREA)
    assert np.median(errors) < 0.1
    foretold = 1e3 * float(np.median(verdict.area_m))
    assert 0.2 < foretold / float(np.median(errors)) < 5.0


def test_every_closed_form_is_tried_and_none_is_better_than_the_fit(session: Session) -> None:
    verdict = solved(session)
    assert {told.form.name for told in verdict.forms} == {
        "Tsai", "Park", "Horaud", "Andreff", "Daniilidis", "Shah", "Li",
    }  # fmt: skip
    assert verdict.fit is not None
    assert verdict.fit.rms_px <= min(told.rms_px for told in verdict.forms if told.form.found) + 0.01


def test_one_wrong_pose_among_fifteen_is_named_and_the_others_still_give_the_camera(session: Session) -> None:
    off = transforms.make([0.02, 0.0, 0.0], [0.004, 0.0, 0.0])
    poses = list(session.sightings)
    poses[6] = replace(poses[6], base_from_tool=transforms.compose(poses[6].base_from_tool, off))
    verdict = solved(replace(session, sightings=tuple(poses)))
    assert not verdict.good
    assert [f.poses for f in verdict.findings if f.trouble is Trouble.WRONG_POSE] == [(6,)]
    assert verdict.fit is not None
    assert np.median(boardrig.errors_mm(verdict.fit.found, session.truth, AREA)) < 0.15


@pytest.mark.parametrize("factor", [1.006, 0.97])
def test_a_wrong_pitch_is_named_with_the_right_size(session: Session, factor: float) -> None:
    wrong = tuple(boardrig.scaled(s, factor) for s in session.sightings)
    verdict = solved(replace(session, sightings=wrong))
    told = [f.value for f in verdict.findings if f.trouble is Trouble.WRONG_PITCH]
    assert told == [pytest.approx(1.0 / factor, abs=0.002)]


def test_a_rig_calibrated_with_the_same_wrong_pitch_is_named_too() -> None:
    session = boardrig.made("fixed")
    motion = session.stereo.right_from_left
    rig = replace(session.stereo, right_from_left=replace(motion, translation=1.02 * motion.translation))
    wrong = tuple(boardrig.scaled(s, 1.02) for s in session.sightings)
    assert troubles(solved(replace(session, sightings=wrong, stereo=rig))) == {
        Trouble.WRONG_PITCH, Trouble.WRONG_RIG,
    }  # fmt: skip


def test_a_mirrored_board_is_named(session: Session) -> None:
    wrong = tuple(boardrig.mirrored(s) for s in session.sightings)
    assert troubles(solved(replace(session, sightings=wrong))) == {Trouble.MIRRORED}


def test_swapped_cameras_are_named() -> None:
    session = boardrig.made("fixed")
    wrong = tuple(boardrig.swapped(s) for s in session.sightings)
    assert troubles(solved(replace(session, sightings=wrong))) == {Trouble.SWAPPED}


def test_poses_the_other_way_round_are_named(session: Session) -> None:
    wrong = tuple(replace(s, base_from_tool=transforms.invert(s.base_from_tool)) for s in session.sightings)
    assert Trouble.INVERTED in troubles(solved(replace(session, sightings=wrong)))


def test_poses_in_the_wrong_order_do_not_fit(session: Session) -> None:
    poses = session.sightings
    wrong = tuple(
        replace(s, base_from_tool=poses[(k + 1) % len(poses)].base_from_tool) for k, s in enumerate(poses)
    )
    assert Trouble.NO_FIT in troubles(solved(replace(session, sightings=wrong)))


def test_weak_motion_is_refused_before_anything_is_solved() -> None:
    little = boardrig.made("fixed", tilt_rad=0.08, spin_rad=0.05)
    verdict = solved(little)
    assert troubles(verdict) == {Trouble.WEAK_MOTION}
    assert verdict.fit is None
    one_axis = boardrig.made("fixed", tilt_rad=0.01, spin_rad=0.8)
    assert troubles(solved(one_axis)) == {Trouble.ONE_AXIS}
    few = boardrig.made("fixed", poses=5)
    assert troubles(solved(few)) == {Trouble.TOO_FEW}


def test_poses_that_only_shift_do_not_turn() -> None:
    poses = [transforms.make(np.eye(3), [0.1 * k, 0.0, 0.0]) for k in range(15)]
    assert {f.trouble for f in weak(motion_of(poses), 15)} == {Trouble.WEAK_MOTION}


@pytest.mark.shared_data
@pytest.mark.skipif(not boardrig.SHARED.exists(), reason="the shared data is not there")
@pytest.mark.parametrize("mode", ["eye_to_hand", "eye_in_hand"])
def test_the_rendered_poses_give_the_camera_within_half_a_millimetre(mode: str) -> None:
    session = boardrig.rendered(mode)
    fifteen = replace(session, sightings=session.sightings[:15])
    verdict = solved(fifteen)
    assert verdict.good
    assert verdict.fit is not None
    errors = boardrig.errors_mm(verdict.fit.found, session.truth, area_points(session.stereo, 0.4))
    assert np.median(errors) < 0.5
    assert np.percentile(errors, 95) < 1.0
