"""The fit's derivative is that of its residuals."""

from __future__ import annotations

import numpy as np
import pytest

from tests.fakes import boardrig
from vision import transforms
from vision.handeye import HandEye, Mount, camera_from_board, mount_from_held
from vision.handeye_fit import _Problem, board_pose


@pytest.mark.parametrize("mount", ["fixed", "tool"])
def test_the_derivative_is_that_of_differences(mount: Mount) -> None:
    session = boardrig.made(mount, poses=4)
    scales = 2 if mount == "fixed" else 1
    problem = _Problem(session.sightings, session.stereo, mount, scales)
    first = session.sightings[0]
    seen = board_pose(first, session.stereo)
    assert seen is not None
    held = transforms.compose(transforms.invert(mount_from_held(first, mount)), session.truth, seen)
    start = HandEye(mount_from_camera=session.truth, held_from_board=held)
    rng = np.random.default_rng(5)
    step = rng.normal(0.0, 0.02, problem.size)
    exact = problem.slopes(start, step)
    for k in range(problem.size):
        ahead, behind = step.copy(), step.copy()
        ahead[k] += 1e-6
        behind[k] -= 1e-6
        differences = (problem.apart(start, ahead) - problem.apart(start, behind)) / 2e-6
        assert exact[:, k] == pytest.approx(differences, rel=1e-4, abs=1e-2)


def test_the_pose_of_a_board_is_found_from_both_pictures() -> None:
    session = boardrig.made("fixed", poses=6)
    for sighting in session.sightings:
        found = board_pose(sighting, session.stereo)
        assert found is not None
        assert 0.3 < found.translation[2] < 0.5
        again = camera_from_board(
            HandEye(mount_from_camera=transforms.identity(), held_from_board=found), transforms.identity()
        )
        assert transforms.rotation_distance_rad(again.rotation, found.rotation) < 1e-9
