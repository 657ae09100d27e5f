"""Several products in one heap: the configuration, an order, `mikado look` and `mikado evaluate`."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.mixed import Heap, heaps
from bench.piles import write_rig, write_scene
from bench.rigs import WEBCAM, rig_text
from cell import config, cycle, frames, products
from cell.cli import main
from cell.config import PartConfig, heap_of
from cell.cycle import run_order
from cell.errors import ConfigError, UsageError
from cell.evaluate import evaluate
from cell.planning import plan_picks
from cell.types import Outcome, PickOrder, PickResult
from drivers.timing import StopToken
from drivers.types import PlcCommand, ResultCode
from tests.fakes.station import DATA, Bench, bench, order, scene, stick
from vision.offer import WIDTH_SHARE
from vision.types import Candidate, PartModel, Refusal, Refused, Scene

TEXT = (DATA / "cell.yaml").read_text()
PARTS = (
    "  - {code: 1, name: stick-80, length_m: 0.080, length_tolerance_m: 0.004, diameter_m: 0.004}\n"
    "  - {code: 2, name: stick-120, length_m: 0.120, length_tolerance_m: 0.004, diameter_m: 0.004}\n"
)
assert PARTS in TEXT


def part(code: int = 1, **changes: object) -> PartConfig:
    fields: dict[str, object] = {
        "code": code,
        "name": f"part-{code}",
        "length_m": 0.1,
        "length_tolerance_m": 0.004,
        "diameter_m": 0.004,
    }
    return PartConfig.model_validate({**fields, **changes})


# ------------------------------------------------------------------------------ configuration


def written(tmp_path: Path, heaps: str, parts: str = PARTS, more: str = "") -> Path:
    path = tmp_path / "cell.yaml"
    path.write_text(TEXT.replace(PARTS, parts) + f"heaps: {heaps}\n{more}")
    return path


def test_parts_of_a_heap_are_looked_for_among_each_other(tmp_path: Path) -> None:
    third = "  - {code: 5, name: other, length_m: 0.1, length_tolerance_m: 0.004, diameter_m: 0.004}\n"
    loaded = config.load(written(tmp_path, "[[2, 1]]", PARTS + third))

    assert [other.code for other in loaded.among(loaded.parts[0])] == [2]
    assert [other.code for other in loaded.among(loaded.parts[1])] == [1]
    assert loaded.among(loaded.parts[2]) == ()
    assert config.load(DATA / "cell.yaml").among(loaded.parts[0]) == ()


@pytest.mark.parametrize(
    ("heaps", "said"),
    [
        ("[[1]]", r"heaps: \[1\] is no heap of several parts"),
        ("[[1, 3]]", "heaps: there is no part with code 3; parts has 1, 2"),
        ("[[1, 2, 1]]", "heaps: code 1 is given twice"),
        ("[[1, 2], [2, 1]]", "heaps: code 1 is given twice"),
        ("[[0, 1]]", "heaps.*greater than or equal to 1, found 0"),
    ],
)
def test_a_heap_that_cannot_be_meant_is_refused(tmp_path: Path, heaps: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        config.load(written(tmp_path, heaps))


def test_parts_that_nothing_tells_apart_are_refused_by_name(tmp_path: Path) -> None:
    alike = PARTS.replace("0.120", "0.086")
    with pytest.raises(ConfigError, match=r"parts 1 \(stick-80\) and 2 \(stick-120\) cannot be told apart"):
        config.load(written(tmp_path, "[[1, 2]]", alike))


def test_the_published_method_knows_no_heaps(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="the published method knows one product a look"):
        config.load(written(tmp_path, "[[1, 2]]", more="tuning: {method: published}\n"))


BLUE = {"hue_deg": (185, 260)}
RED = {"hue_deg": (335, 14)}
ORANGE = {"hue_deg": (10, 40)}
PALE = {"saturation": (0.0, 0.1)}
STRONG = {"saturation": (0.3, 1.0)}


@pytest.mark.parametrize(
    ("one", "other", "apart"),
    [
        ({}, {}, False),
        ({}, {"length_m": 0.108}, False),
        ({}, {"length_m": 0.1081}, True),
        ({}, {"diameter_m": 0.0055}, False),
        ({}, {"diameter_m": 0.0057}, True),
        ({"colour": BLUE}, {}, False),
        ({"colour": BLUE}, {"colour": RED}, True),
        ({"colour": RED}, {"colour": ORANGE}, False),
        ({"colour": BLUE}, {"colour": {"hue_deg": (200, 210)}}, False),
        ({"colour": PALE}, {"colour": STRONG}, True),
        ({"colour": {"value": (0.0, 0.2)}}, {"colour": {"value": (0.1, 1.0)}}, False),
    ],
)
def test_parts_are_told_apart_by_length_thickness_or_colour(
    one: dict[str, object], other: dict[str, object], apart: bool
) -> None:
    assert part(1, **one).apart_from(part(2, **other)) is apart
    assert part(2, **other).apart_from(part(1, **one)) is apart


def test_what_counts_as_another_thickness_is_refused_by_the_detector() -> None:
    assert max(WIDTH_SHARE[1], 1 / WIDTH_SHARE[0]) < products.TOLD_BY_WIDTH


# ------------------------------------------------------------------------------ orders


EIGHTY = stick((-0.04, -0.45, 0.022), (0.04, -0.45, 0.022))
LONG = replace(stick((-0.06, -0.38, 0.022), (0.06, -0.38, 0.022)), part_code=2)
COVERED = Refused(reason=Refusal.CROSSED, value=1.0, limit=0.0, unit="1")


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[Bench, list[tuple[PartModel, ...]]]]:
    """A cell whose two parts lie in one heap, and what its detector was asked for."""

    def use(*candidates: Candidate) -> tuple[Bench, list[tuple[PartModel, ...]]]:
        asked: list[tuple[PartModel, ...]] = []

        def locate(*given: object, among: tuple[PartModel, ...], **_: object) -> Scene:
            wanted = given[3]
            assert isinstance(wanted, PartModel)
            asked.append((wanted, *among))
            return scene(*candidates)

        monkeypatch.setattr(cycle, "locate", locate)
        made = bench().open()
        made.station = replace(made.station, heaps=((1, 2),))
        return made, asked

    return use


def ran(made: Bench, wanted: PickOrder) -> PickResult:
    return run_order(made.station, wanted, StopToken(made.clock))


@pytest.mark.parametrize(("code", "y_m"), [(1, -0.45), (2, -0.38)])
def test_an_order_takes_a_part_of_its_code(
    cell: Callable[..., tuple[Bench, list[tuple[PartModel, ...]]]], code: int, y_m: float
) -> None:
    made, asked = cell(EIGHTY, LONG)

    result = ran(made, order(part_code=code))

    assert (result.code, result.outcome, result.part_type) == (ResultCode.OK, Outcome.PICKED, code)
    assert result.pose is not None
    assert result.pose.y == pytest.approx(y_m)
    assert result.seen == 1
    assert [model.code for model in asked[0]] == [code, 3 - code]


def test_where_only_the_other_part_lies_nothing_is_taken_and_the_bin_is_not_empty(
    cell: Callable[..., tuple[Bench, list[tuple[PartModel, ...]]]],
) -> None:
    made, _ = cell(LONG)

    result = ran(made, order(part_code=1))

    assert (result.code, result.outcome) == (ResultCode.NO_PART_FOUND, Outcome.NOTHING_GRASPABLE)
    assert (result.seen, result.part_type, result.refused) == (0, 1, {})
    assert made.gripper.calls == []


def test_a_covered_part_of_the_order_is_taken_before_a_free_one_of_another(
    cell: Callable[..., tuple[Bench, list[tuple[PartModel, ...]]]],
) -> None:
    made, _ = cell(replace(LONG, score=1.0), replace(EIGHTY, refusals=(COVERED,)))

    result = ran(made, order(part_code=1))

    assert result.outcome is Outcome.PICKED
    assert result.pose is not None
    assert result.pose.y == pytest.approx(-0.45)


def test_a_look_counts_what_its_order_could_have(
    cell: Callable[..., tuple[Bench, list[tuple[PartModel, ...]]]],
) -> None:
    made, _ = cell(EIGHTY, LONG, replace(LONG, refusals=(COVERED,)))

    result = ran(made, order(part_code=2, command=PlcCommand.VISION_ONLY))

    assert (result.quantity, result.seen, result.refused) == (1, 2, {"CROSSED": 1})
    (look,) = made.looks
    assert [other.code for other in look.among] == [1]


def test_no_code_is_a_question_in_a_heap_too(
    cell: Callable[..., tuple[Bench, list[tuple[PartModel, ...]]]],
) -> None:
    made, asked = cell(EIGHTY, LONG)

    assert ran(made, order(part_code=0)).code is ResultCode.BAD_PARAMETER
    assert asked == []


def test_real_pictures_of_one_length_have_nothing_of_another() -> None:
    made = bench(pictures=2).open()
    made.station = replace(made.station, heaps=((1, 2),))

    other = ran(made, order(part_code=2))
    own = ran(made, order(part_code=1))

    assert (other.code, other.outcome) == (ResultCode.NO_PART_FOUND, Outcome.NOTHING_GRASPABLE)
    assert (own.code, own.part_type) == (ResultCode.OK, 1)


def test_thick_neighbours_need_more_room_than_thin_ones() -> None:
    made = bench()
    station = made.station
    # 18 mm from axis to axis: the open hand fits beside parts of 4 mm, not beside any of 9 mm
    seen = scene(
        EIGHTY,
        replace(stick((-0.04, -0.432, 0.022), (0.04, -0.432, 0.022)), part_code=2),
        replace(stick((-0.04, -0.468, 0.022), (0.04, -0.468, 0.022)), part_code=2),
    )
    tool = frames.transform_of(frames.tool_down(np.zeros(3), 0.0))
    where = (
        station.mounting.view(tool).base_from_camera,
        station.workspace,
        station.jaws,
        0.004,
        tool,
        station.missed,
        lambda pick: pick,
    )
    picks = [plan_picks(seen, *where, 1, thickest_m) for thickest_m in (None, 0.009)]

    assert [len(plans) for plans in picks] == [1, 1]
    assert picks[0][0].pick is not None
    assert picks[1][0].pick is None


def test_the_heap_of_a_part_leaves_out_the_part_itself() -> None:
    parts = (part(1), part(2), part(3))

    assert heap_of(parts[1], parts, ((3, 2),)) == (parts[2],)
    assert heap_of(parts[0], parts, ((3, 2),)) == ()


# ------------------------------------------------------------------------------ look and evaluate


def product(folder: Path, model: PartModel) -> Path:
    """A product file."""
    path = folder / f"{model.code}.yaml"
    colour = ""
    if model.colour is not None:
        c = model.colour
        colour = f"colour: {{hue_deg: {list(c.hue_deg)}, saturation: {list(c.saturation)}}}\n"
    path.write_text(
        f"code: {model.code}\nname: {model.name}\nlength_m: {model.length_m}\nlength_tolerance_m: 0.004\n"
        f"diameter_m: {model.diameter_m}\n{colour}"
    )
    return path


@pytest.fixture(scope="module")
def heap() -> Heap:
    (made,) = heaps("both", WEBCAM, 1, seed=8)
    return made


def test_a_look_names_the_product_of_every_part(
    tmp_path: Path, heap: Heap, capsys: pytest.CaptureFixture[str]
) -> None:
    for side, view in zip(("left", "right"), heap.shot.views, strict=True):
        cv2.imwrite(str(tmp_path / f"{side}.png"), view.pixels)
    (tmp_path / "rig.json").write_text(rig_text(WEBCAM))
    files = [str(product(tmp_path, model)) for model in heap.parts]
    arguments = ["--left", str(tmp_path / "left.png"), "--right", str(tmp_path / "right.png")]
    arguments += ["--calibration", str(tmp_path / "rig.json"), "--out", str(tmp_path / "out")]

    assert main(["look", *arguments, "--product", *files]) == 0

    document = json.loads((tmp_path / "out" / "look.json").read_text())
    assert document["part"]["code"] == 1
    assert [one["code"] for one in document["among"]] == [2, 3, 4]
    found = [c for c in document["candidates"] if c["offered"]]
    assert {c["part"] for c in found} >= {1, 2}
    for entry in found:
        middle = (np.array(entry["start_m"]) + entry["end_m"]) / 2
        true = [float(np.linalg.norm(one.ends.mean(axis=0) - middle)) for one in heap.truth.parts]
        assert heap.codes[int(np.argmin(true))] == entry["part"]
        assert min(true) < 0.004
    said = capsys.readouterr().out
    assert "of other products" in said
    assert "blue" in said


def test_products_that_nothing_tells_apart_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    twins = [tmp_path / "one.yaml", tmp_path / "two.yaml"]
    for code, path in enumerate(twins, start=1):
        path.write_text((DATA / "part.yaml").read_text().replace("code: 1", f"code: {code}"))
    arguments = ["look", "--left", str(DATA / "left.png"), "--right", str(DATA / "right.png")]
    arguments += [
        "--calibration",
        str(DATA / "calibration.json"),
        "--out",
        str(tmp_path / "out"),
        "--product",
    ]

    assert main([*arguments, *map(str, twins)]) == 2
    assert "one.yaml and " in (said := capsys.readouterr().err)
    assert "nothing tells stick-80 from stick-80" in said
    assert main([*arguments, str(twins[0]), str(twins[0])]) == 2
    assert "have the same code 1" in capsys.readouterr().err
    assert main([*arguments, *map(str, twins), "--method", "published"]) == 2
    assert "the published method knows one product a look" in capsys.readouterr().err


def test_evaluate_tells_other_products_from_what_a_scene_asks_for(tmp_path: Path, heap: Heap) -> None:
    write_rig(tmp_path, WEBCAM)
    write_scene(tmp_path, "mixed", heap.shot, "both", 8)
    # the scene asks for sticks of any colour as long as the first two products
    files = tuple(product(tmp_path, replace(model, colour=None)) for model in heap.parts[2:])

    evaluate(tmp_path, tmp_path / "out", "default", among=(*files, product(tmp_path, heap.parts[0])))

    result = json.loads((tmp_path / "out" / "mixed.json").read_text())
    others = {one["product"] for one in result["others"]}
    assert others == {model.name for model in heap.parts[2:]}
    assert result["detections"]
    for detection in result["detections"]:
        middle = (np.array(detection["p0"]) + detection["p1"]) / 2000
        true = [float(np.linalg.norm(one.ends.mean(axis=0) - middle)) for one in heap.truth.parts]
        assert heap.codes[int(np.argmin(true))] in (1, 2)


def test_evaluate_knows_one_product_with_the_published_method(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="knows one product a look"):
        evaluate(tmp_path, tmp_path / "out", "published", among=(DATA / "part.yaml",))
