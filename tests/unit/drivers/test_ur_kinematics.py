"""The simulated controller's kinematics against ur-analytic-ik, which nobody here wrote."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
import ur_analytic_ik

from drivers.sim.ur_kinematics import (
    LIMIT_RAD,
    MODELS,
    Placement,
    Six,
    branch_of,
    compose,
    forward,
    inverse,
    placement_of,
    pose_of,
    posture,
    postures,
    six,
)

PEERS = {"UR3e": ur_analytic_ik.ur3e, "UR5e": ur_analytic_ik.ur5e, "UR10e": ur_analytic_ik.ur10e}
NEAR: Six = (0.1, -1.4, 1.6, -1.7, -1.5, 0.2)


def matrix(placement: Placement) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """A placement as the (4, 4) matrix the peer speaks."""
    found = np.eye(4)
    for column, axis in enumerate(placement):
        found[:3, column] = axis
    return found


def some_joints(numbers: random.Random) -> Six:
    return six([numbers.uniform(-math.pi, math.pi) for _ in range(6)])


@pytest.mark.parametrize("model", sorted(MODELS))
def test_the_flange_is_where_an_independent_library_has_it(model: str) -> None:
    numbers = random.Random(1)
    for _ in range(300):
        q = some_joints(numbers)
        assert matrix(forward(MODELS[model], q)) == pytest.approx(
            PEERS[model].forward_kinematics(*q), abs=1e-12
        )


@pytest.mark.parametrize("model", sorted(MODELS))
def test_every_posture_it_finds_brings_the_flange_there(model: str) -> None:
    numbers = random.Random(2)
    for _ in range(300):
        q = some_joints(numbers)
        goal = forward(MODELS[model], q)
        found = postures(MODELS[model], goal, q)
        assert found[0][1] == pytest.approx(q, abs=1e-6)  # the one it came from is the nearest
        for _, each in found:
            assert matrix(forward(MODELS[model], each)) == pytest.approx(matrix(goal), abs=1e-9)


@pytest.mark.parametrize("model", sorted(MODELS))
def test_it_finds_as_many_postures_as_the_independent_library(model: str) -> None:
    numbers = random.Random(3)
    for _ in range(200):
        q = some_joints(numbers)
        goal = forward(MODELS[model], q)
        theirs = PEERS[model].inverse_kinematics(matrix(goal))
        assert len(postures(MODELS[model], goal, q)) == len(theirs)


def test_out_of_reach_there_is_no_posture() -> None:
    goal = placement_of((1.2, 0.0, 0.3, math.pi, 0.0, 0.0))
    assert postures(MODELS["UR5e"], goal, NEAR) == []
    assert PEERS["UR5e"].inverse_kinematics(matrix(goal)) == []


def test_inside_the_shoulder_there_is_no_posture() -> None:
    assert postures(MODELS["UR5e"], placement_of((0.05, 0.0, 0.4, math.pi, 0.0, 0.0)), NEAR) == []


def test_the_turn_nearest_to_where_the_arm_is_is_taken_within_the_limits() -> None:
    links = MODELS["UR5e"]
    q: Six = (3.0, -1.4, 1.6, -1.7, -1.5, 6.0)
    found = posture(links, forward(links, q), branch_of(links, q), q)
    assert found == pytest.approx(q, abs=1e-9)
    beyond: Six = (3.0, -1.4, 1.6, -1.7, -1.5, 6.5)  # past the last joint's limit: a turn back
    found = posture(links, forward(links, beyond), branch_of(links, q), q)
    assert found is not None
    assert found[5] == pytest.approx(6.5 - 2.0 * math.pi, abs=1e-9)
    assert all(abs(a) <= limit for a, limit in zip(found, LIMIT_RAD, strict=True))


def test_in_the_wrist_singularity_the_last_joint_stays() -> None:
    links = MODELS["UR5e"]
    q: Six = (0.3, -1.4, 1.6, -1.7, 0.0, 0.4)
    found = posture(links, forward(links, q), branch_of(links, q), q)
    assert found is not None
    assert found[5] == q[5]
    assert matrix(forward(links, found)) == pytest.approx(matrix(forward(links, q)), abs=1e-9)


def test_a_pose_comes_back_from_its_placement_also_at_half_turns() -> None:
    numbers = random.Random(4)
    rotations = [
        (0.0, 0.0, 0.0),
        (math.pi, 0.0, 0.0),
        (0.0, math.pi, 0.0),
        (0.0, 0.0, math.pi),
        (1e-9, 0.0, 0.0),
    ]
    for _ in range(200):
        axis = np.array([numbers.gauss(0.0, 1.0) for _ in range(3)])
        rotations.append(tuple(axis / np.linalg.norm(axis) * numbers.uniform(0.0, math.pi)))
    for rx, ry, rz in rotations:
        pose = (0.1, -0.2, 0.3, rx, ry, rz)
        back = pose_of(placement_of(pose))
        same = matrix(placement_of(back)) - matrix(placement_of(pose))
        assert np.abs(same).max() < 1e-9
        assert back[3:] == pytest.approx(pose[3:], abs=1e-6)


def test_a_placement_and_its_inverse_cancel() -> None:
    there = placement_of((0.1, -0.2, 0.3, 0.5, -1.0, 2.0))
    assert matrix(compose(there, inverse(there))) == pytest.approx(np.eye(4), abs=1e-12)
