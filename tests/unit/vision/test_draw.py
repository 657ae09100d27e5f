"""The overlay: things are drawn where they are, and said in words a person reads."""

from dataclasses import replace

import numpy as np
import pytest

from vision import draw, stereo, transforms
from vision.types import (
    CameraModel,
    Candidate,
    Crossing,
    Floats,
    Graph,
    Matches,
    PartModel,
    Refusal,
    Refused,
    Scene,
    Segments3D,
    StereoModel,
    View,
)

CAMERA = CameraModel(
    matrix=np.array([[300.0, 0, 160], [0, 300.0, 120], [0, 0, 1]]),
    distortion=np.array([-0.1, 0.0, 0.0, 0.0, 0.0]),
    width_px=320,
    height_px=240,
)
RIG = StereoModel(
    left=CAMERA, right=CAMERA, right_from_left=transforms.make([0.0, 0.0, 0.0], [-0.08, 0.0, 0.0])
)
STICK = PartModel(code=1, name="rod-100", length_m=0.1, length_tolerance_m=0.004, diameter_m=0.004)
GREY = np.full((240, 320), 60, np.uint8)


def candidate(start: list[float], end: list[float], *refusals: Refused) -> Candidate:
    ends: Floats = np.array([start, end])
    way = ends[1] - ends[0]
    length = float(np.linalg.norm(way))
    return Candidate(
        part_code=1,
        start=ends[0],
        end=ends[1],
        centre=ends.mean(axis=0),
        axis=way / length,
        length_m=length,
        nodes=ends,
        score=0.9,
        residual_px=0.2,
        refusals=refusals,
    )


def scene(*candidates: Candidate) -> Scene:
    empty = np.zeros((0, 2))
    graph = Graph(
        points=empty,
        degree=np.zeros(0, np.int64),
        component=np.zeros(0, np.int64),
        edges=np.zeros((0, 2), np.int64),
        lengths_px=np.zeros(0),
        paths=(),
    )
    blank = np.zeros(GREY.shape, np.bool_)
    view = View(grey=GREY, mask=blank, skeleton=blank, graph=graph, band=(140, 255))
    none = np.zeros(0, np.int64)
    return Scene(
        method="default",
        candidates=candidates,
        segments=Segments3D(start=np.zeros((0, 3)), end=np.zeros((0, 3)), edge=none, residual_px=np.zeros(0)),
        left=view,
        right=view,
        matches=Matches(left=none, right=none, cost_px=np.zeros(0), unmatched=0, ambiguous=0),
    )


def greenish(picture: draw.Picture) -> tuple[Floats, Floats]:
    b, g, r = (picture[:480, :, k].astype(int) for k in range(3))
    rows, columns = np.nonzero((g > 150) & (g > b + 60) & (g > r + 60))
    return columns.astype(np.float64), rows.astype(np.float64)


def test_an_offered_stick_is_green_where_it_is_seen() -> None:
    found = candidate([-0.05, 0.03, 0.4], [0.05, 0.03, 0.4])
    picture = draw.draw(GREY, scene(found), RIG, STICK)
    assert picture.shape == (480 + draw.LEGEND_PX, 640, 3)
    for end in (found.start, found.end):
        u, v = 2 * stereo.project(end[None], RIG)[0][0] + 0.5
        columns, rows = greenish(picture)
        assert np.hypot(columns - u, rows - v).min() < 2.0


def test_a_refused_stick_is_not_green() -> None:
    reason = Refused(reason=Refusal.LENGTH, value=0.112, limit=0.104, unit="m")
    picture = draw.draw(GREY, scene(candidate([-0.05, 0, 0.4], [0.06, 0, 0.4], reason)), RIG, STICK)
    assert len(greenish(picture)[0]) == 0
    assert np.count_nonzero(picture[:480, :, 2] > 150) > 50


def test_the_given_picture_is_not_changed_and_colour_is_taken_too() -> None:
    colour = np.repeat(GREY[:, :, None], 3, axis=2)
    before = colour.copy()
    draw.draw(colour, scene(candidate([-0.05, 0, 0.4], [0.05, 0, 0.4])), RIG, STICK)
    np.testing.assert_array_equal(colour, before)


UPPER = candidate([-0.05, 0.0, 0.39], [0.05, 0.0, 0.39])
LOWER = candidate([0.0, -0.05, 0.4], [0.0, 0.05, 0.4])


def crossed(sure: float, above: int = 0) -> Scene:
    point = np.array([0.0, 0.0, 0.39])
    over = Crossing(above=above, below=1 - above, point=point, gap_m=0.006, sure=sure)
    return replace(scene(UPPER, LOWER), crossings=(over,))


def white(picture: draw.Picture) -> tuple[Floats, Floats]:
    """Places of white pixels from the middle of the drawn picture; to the right, down."""
    u, v = 2 * stereo.project(np.array([[0.0, 0.0, 0.39]]), RIG)[0][0] + 0.5
    rows, columns = np.nonzero((picture[:480] > 130).all(axis=2))
    return columns - u, rows - v


@pytest.mark.parametrize("above", [0, 1], ids=["the level one", "the upright one"])
def test_a_part_that_lies_over_another_has_rails_along_it(above: int) -> None:
    plain = white(draw.draw(GREY, scene(UPPER, LOWER), RIG, STICK))
    places = white(draw.draw(GREY, crossed(4.0, above), RIG, STICK))
    assert len(plain[0]) == 0
    along, across = places if above == 0 else places[::-1]
    assert np.abs(np.abs(across) - draw.RAIL_PX).max() < 2.0
    assert np.ptp(along) > draw.BRIDGE_PX
    assert across.min() < 0 < across.max()


def test_an_order_in_doubt_is_a_ring() -> None:
    along, across = white(draw.draw(GREY, crossed(0.4), RIG, STICK))
    assert len(along) > 10
    assert np.abs(np.hypot(along, across) - draw.RING_PX).max() < 2.0


def test_corrected_rows_are_said_in_a_line_of_their_own() -> None:
    plain = draw.draw(GREY, scene(UPPER), RIG, STICK)
    moved = draw.draw(GREY, replace(scene(UPPER), row_offset_px=-1.7), RIG, STICK)
    assert moved.shape[0] == plain.shape[0] + draw.LEGEND_PX
    assert np.count_nonzero(moved[-draw.LEGEND_PX :] > 200) > 50


def test_a_part_outside_the_picture_does_no_harm() -> None:
    far = candidate([-0.9, 0.0, 0.4], [0.9, 0.0, 0.4])
    behind = candidate([0.0, 0.0, -0.4], [0.1, 0.0, -0.4])
    assert draw.draw(GREY, scene(far, behind), RIG, STICK).shape[2] == 3


def test_a_picture_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="320 x 240"):
        draw.draw(GREY[:100], scene(), RIG, STICK)


@pytest.mark.parametrize(
    ("refused", "text"),
    [
        (
            Refused(reason=Refusal.LENGTH, value=0.1124, limit=0.104, unit="m"),
            "length 112.4 > 104.0 mm",
        ),
        (Refused(reason=Refusal.TILT, value=0.9, limit=0.7, unit="rad"), "tilt 52 > 40 deg"),
        (Refused(reason=Refusal.LOW_SCORE, value=0.1, limit=0.3, unit="1"), "score 0.10 < 0.30"),
        (Refused(reason=Refusal.CROSSED, value=2.0, limit=0.0, unit="1"), "2 over it"),
        (Refused(reason=Refusal.COLOUR, value=3.9, limit=0.244, unit="rad"), "hue 223, not 14 deg"),
        (Refused(reason=Refusal.COLOUR, value=0.04, limit=0.07, unit="1"), "colour 0.04 < 0.07"),
        (Refused(reason=Refusal.FLANKS, value=0.05, limit=0.1, unit="1"), "one flank 0.05 < 0.10"),
        (Refused(reason=Refusal.BENT, value=1.24, limit=0.8, unit="px"), "bent 1.2 > 0.8 px"),
        (Refused(reason=Refusal.VAGUE, value=0.0062, limit=0.004, unit="m"), "vague 6.2 > 4.0 mm"),
        (Refused(reason=Refusal.ROWS, value=4.1, limit=3.0, unit="px"), "rows off 4.1 > 3.0 px"),
        (Refused(reason=Refusal.DUPLICATE, value=1.0, limit=0.0, unit="1"), "duplicate"),
    ],
)
def test_reasons_are_short_and_in_millimetres_and_degrees(refused: Refused, text: str) -> None:
    assert draw.refusal_text(refused) == text


def test_every_refusal_has_a_short_name() -> None:
    assert set(draw.SHORT) == set(Refusal)
