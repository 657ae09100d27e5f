"""Kinematics of UR arms against a library nobody here wrote, and against their own Jacobian."""

from __future__ import annotations

import math
from typing import Protocol, cast

import numpy as np
import pytest
import ur_analytic_ik

from drivers.robot.ur_postures import MODELS, Floats, distances, joint_frames, postures


class Arm(Protocol):
    """What is used of one arm of the library."""

    def forward_kinematics(self, *q: float) -> Floats: ...
    def inverse_kinematics(self, pose: Floats, /) -> list[Floats]: ...


def library(model: str) -> Arm:
    return cast(Arm, getattr(ur_analytic_ik, model.lower()))


def some_joints(count: int, seed: int = 1) -> Floats:
    return np.random.default_rng(seed).uniform(-math.pi, math.pi, (count, 6))


def apart(a: Floats, b: Floats) -> Floats:
    """Largest difference of angles of the last axis, whole turns aside."""
    return np.asarray(np.abs((a - b + math.pi) % (2 * math.pi) - math.pi).max(axis=-1))


@pytest.mark.parametrize("model", MODELS)
def test_forward_is_the_librarys(model: str) -> None:
    for q in some_joints(200):
        ours = joint_frames(MODELS[model], q)[6]
        assert ours == pytest.approx(library(model).forward_kinematics(*q), abs=1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_every_posture_of_the_library_is_found_and_no_other(model: str) -> None:
    joints = some_joints(200, seed=2)
    links = MODELS[model]
    found = postures(links, np.array([joint_frames(links, q)[6] for q in joints])).q_rad
    for q, ours in zip(joints, found, strict=True):
        real = ours[~np.isnan(ours).any(axis=1)]
        theirs = library(model).inverse_kinematics(joint_frames(links, q)[6])
        assert len(real) == len(theirs)
        for other in (q, *theirs):
            assert apart(real, np.asarray(other)).min() < 1e-6


@pytest.mark.parametrize("model", MODELS)
def test_each_posture_leads_back_to_its_pose(model: str) -> None:
    links = MODELS[model]
    poses = np.array([joint_frames(links, q)[6] for q in some_joints(100, seed=3)])
    for pose, branches in zip(poses, postures(links, poses).q_rad, strict=True):
        for q in branches[~np.isnan(branches).any(axis=1)]:
            assert joint_frames(links, q)[6] == pytest.approx(pose, abs=1e-8)


def test_out_of_reach_has_no_posture_but_a_length_that_is_needed() -> None:
    links = MODELS["UR5e"]
    far = np.diag([1.0, -1.0, -1.0, 1.0])
    far[:3, 3] = (1.2, 0.0, 0.3)
    found = postures(links, far[None])
    assert np.isnan(found.q_rad).all()
    assert np.nanmin(found.needed_m) > links.stretched_m


def test_within_the_bases_column_there_is_no_posture_and_no_length() -> None:
    links = MODELS["UR5e"]
    near = np.diag([1.0, -1.0, -1.0, 1.0])
    near[:3, 3] = (0.05, 0.0, 0.3)
    found = postures(links, near[None])
    assert np.isnan(found.q_rad).all()
    assert float(found.beside_m[0]) == pytest.approx(0.05)


@pytest.mark.parametrize("model", MODELS)
def test_the_distances_multiply_to_the_determinant_of_the_jacobian(model: str) -> None:
    links, joints = MODELS[model], some_joints(200, seed=4)
    near = distances(links, joints)
    product = abs(links.a2 * links.a3) * np.sin(near.elbow_rad) * np.sin(near.wrist_rad) * near.shoulder_m
    for q, expected in zip(joints, product, strict=True):
        frames = joint_frames(links, q)
        axes = frames[:6, :3, 2]
        jacobian = np.vstack([np.cross(axes, frames[6, :3, 3] - frames[:6, :3, 3]).T, axes.T])
        assert abs(float(np.linalg.det(jacobian))) == pytest.approx(expected, abs=1e-12)
