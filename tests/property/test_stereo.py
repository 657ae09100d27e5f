"""What holds for every point in front of every sensible rig."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vision import stereo, transforms
from vision.types import CameraModel, StereoModel

small = st.floats(min_value=-0.08, max_value=0.08)


@st.composite
def rigs(draw: st.DrawFn) -> StereoModel:
    focal = draw(st.floats(min_value=400.0, max_value=900.0))
    k1 = draw(st.floats(min_value=-0.15, max_value=0.1))
    camera = CameraModel(
        matrix=np.array([[focal, 0, 320], [0, focal * 1.001, 240], [0, 0, 1]]),
        distortion=np.array([k1, 0.02, 0.0005, -0.0005, 0.0]),
        width_px=640,
        height_px=480,
    )
    turn = [draw(small), draw(small), draw(small)]
    baseline = draw(st.floats(min_value=0.05, max_value=0.15))
    motion = transforms.make(turn, [-baseline, 0.1 * draw(small), 0.1 * draw(small)])
    return StereoModel(left=camera, right=camera, right_from_left=motion)


@given(rigs(), st.tuples(small, small, st.floats(min_value=0.3, max_value=0.6)))
@settings(deadline=None, max_examples=40)
def test_project_undistort_triangulate_returns_the_point(
    rig: StereoModel, point_m: tuple[float, float, float]
) -> None:
    rect = stereo.rectification(rig)
    left, right = stereo.project([point_m], rig)
    found = stereo.triangulate(
        stereo.rectify_points(left, rect, "left"), stereo.rectify_points(right, rect, "right"), rect
    )
    # OpenCV undoes distortion step by step and stops a few thousandths of a pixel early
    np.testing.assert_allclose(found, [point_m], atol=1e-5)
