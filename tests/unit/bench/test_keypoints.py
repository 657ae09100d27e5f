"""Keypoint matches are judged by where they should end, not by where they look good."""

from __future__ import annotations

import cv2
import numpy as np

from bench.cases import Case
from bench.keypoints import judge, matched, project, true_places
from bench.scoring import TruePart, Truth
from vision.types import CameraModel, Floats, PartModel, Plane, StereoModel, Transform, read_only

CAMERA = CameraModel(
    matrix=read_only(np.array([[500.0, 0.0, 160.0], [0.0, 500.0, 120.0], [0.0, 0.0, 1.0]])),
    distortion=read_only(np.array([-0.05, 0.02, 0.0, 0.0, 0.0])),
    width_px=320,
    height_px=240,
)
RIGHT_FROM_LEFT = Transform(rotation=np.eye(3), translation=np.array([-0.02, 0.0, 0.0]))
STEREO = StereoModel(left=CAMERA, right=CAMERA, right_from_left=RIGHT_FROM_LEFT)
ENDS = np.array([[[-0.03, -0.02, 0.39], [0.03, -0.01, 0.398]], [[-0.02, 0.02, 0.398], [0.04, 0.03, 0.398]]])


def case() -> Case:
    table = Plane(normal=np.array([0.0, 0.0, -1.0]), offset_m=0.4)
    shows = []
    for offset in (0.0, -0.02):
        ids = np.zeros((240, 320), np.int32)
        for number, ends in enumerate(ENDS, start=1):
            a, b = np.rint(project(ends + np.array([offset, 0.0, 0.0]), CAMERA)).astype(int).tolist()
            cv2.line(ids, a, b, number, 5)
        shows.append(ids)
    parts = tuple(
        TruePart(ends=e, edges=e[None], visible=1.0, in_frame=True, pickable=True, free=True) for e in ENDS
    )
    blank = np.zeros((240, 320), np.uint8)
    return Case(
        family="A",
        name="A-1",
        left=blank,
        right=blank,
        stereo=STEREO,
        table=table,
        part=PartModel(code=1, name="stick", length_m=0.06, length_tolerance_m=0.004, diameter_m=0.004),
        width_m=0.004,
        truth=Truth(parts=parts),
        shows=(shows[0], shows[1]),
    )


def on_axis(part: int, shares: tuple[float, ...]) -> tuple[Floats, Floats]:
    """Where places along a part are in both pictures."""
    places = np.array([ENDS[part, 0] + s * (ENDS[part, 1] - ENDS[part, 0]) for s in shares])
    return project(places, CAMERA), project(places + RIGHT_FROM_LEFT.translation, CAMERA)


def test_a_place_on_a_part_is_found_again_in_the_other_picture() -> None:
    left, right = on_axis(0, (0.1, 0.5, 0.8))
    assert np.abs(true_places(left, np.array([1, 1, 1]), case()) - right).max() < 0.3


def test_matches_on_the_right_places_count_and_two_make_a_part() -> None:
    first_left, first_right = on_axis(0, (0.2, 0.7))
    second_left, second_right = on_axis(1, (0.5,))

    begun, right, parts = judge(
        np.concatenate([first_left, second_left]), np.concatenate([first_right, second_right]), case()
    )

    assert (begun, right) == (3, 3)
    assert parts == {1}


def test_a_match_along_the_same_part_to_another_place_is_wrong() -> None:
    left, _ = on_axis(0, (0.2,))
    _, right = on_axis(0, (0.4,))
    assert judge(left, right, case())[:2] == (1, 0)


def test_matches_that_begin_beside_all_parts_do_not_count() -> None:
    beside = np.array([[20.0, 220.0]])
    assert judge(beside, beside, case())[:2] == (0, 0)


def test_only_clear_matches_that_are_mutual_are_kept() -> None:
    left = np.array([[0, 0], [10, 0], [5, 5]], np.float32)
    right = np.array([[0.1, 0], [10, 0.2], [10, 0.25], [50, 50]], np.float32)

    pairs = matched(left, right, cv2.NORM_L2)

    # the second has two equally near, the third none that likes it back
    assert pairs.tolist() == [[0, 0]]


def test_pictures_without_keypoints_have_no_matches() -> None:
    none = np.zeros((0, 32), np.uint8)
    assert matched(none, none, cv2.NORM_HAMMING).shape == (0, 2)
