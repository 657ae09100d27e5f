"""Words for colours against what pictures show; products told by their colour, from file to detector."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import pytest

from cell import config, cycle, scenes, wiring
from cell.colours import WORDS, in_colour
from cell.commission import look
from cell.config import ColourConfig, PartConfig
from cell.cycle import run_order
from cell.errors import ConfigError, UsageError
from cell.evaluate import evaluate
from cell.faults import PictureUnusable
from drivers.timing import StopToken
from drivers.types import Pixels
from tests.fakes.station import DATA, bench, order, scene, stick
from tests.unit.cell.test_evaluate import RIG, STICK, bars, result, write_scene
from vision.colour import hue_saturation_value
from vision.types import ColourRange, Floats, Scene, Tuning

SHARED = Path(__file__).parents[4] / "shared" / "data" / "scenes-dev" / "scenes"
MIXED: Final = ("F1", "F2", "F3")
WOOD: Final = "colour: {hue_deg: [14, 62], saturation: [0.07, 0.52]}"


def counts_as(word: str, bgr: Floats) -> bool:
    """Whether a colour, 0..1, is inside a word's range, as `vision.colour.refusals` decides it."""
    hue, saturation, value = hue_saturation_value(bgr)
    wanted = WORDS[word]
    low, high = wanted.hue_deg
    between = low <= hue <= high if low <= high else hue >= low or hue <= high
    return between and all(
        least <= number <= most
        for number, (least, most) in ((saturation, wanted.saturation), (value, wanted.value))
    )


def words_of(bgr: tuple[int, int, int]) -> set[str]:
    return {word for word in WORDS if counts_as(word, np.array(bgr) / 255.0)}


@pytest.mark.parametrize(
    ("bgr", "words"),
    [
        ((135, 184, 222), {"wood"}),
        ((99, 140, 186), {"wood"}),
        ((40, 35, 200), {"red"}),
        ((60, 205, 225), {"yellow"}),
        ((90, 160, 95), {"green"}),
        ((180, 110, 80), {"blue"}),
        ((236, 238, 240), {"white", "metal"}),
        ((28, 30, 30), {"black"}),
        ((118, 120, 121), {"white", "metal"}),
    ],
)
def test_usual_colours_have_the_words_people_would_use(bgr: tuple[int, int, int], words: set[str]) -> None:
    assert words_of(bgr) == words


@pytest.mark.shared_data
@pytest.mark.parametrize("gain", [0.35, 0.6, 1.0])
@pytest.mark.parametrize("name", MIXED)
def test_every_rod_of_mixed_scenes_has_its_own_word_and_no_other_in_any_light(name: str, gain: float) -> None:
    folder = SHARED / name
    if not folder.is_dir():
        pytest.skip("no ../shared/data")
    truth = json.loads((folder / "gt.json").read_text(encoding="utf-8"))
    picture = scenes.colour(scenes.SceneFolder(path=folder, name=name, rig=""))
    ids = cv2.imread(str(folder / "ids_left.png"), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    assert ids is not None
    lit = np.rint(picture * gain).astype(np.uint8)
    told: set[str] = set()
    for rod in truth["objects"]:
        inside = cv2.erode((ids == rod["id"] + 1).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        if np.count_nonzero(inside) < 40:
            continue
        seen = np.median(lit[inside], axis=0) / 255.0
        chromatic = {
            word for word in WORDS if word not in ("white", "black", "metal") and counts_as(word, seen)
        }
        assert chromatic == ({rod["colour_name"]} - {"white"}), (rod["id"], seen)
        told |= chromatic
    assert {"wood", "blue", "red"} <= told


def test_three_equal_channels_are_grey() -> None:
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    assert in_colour(grey) is None
    same = np.repeat(grey[..., None], 3, axis=2)
    assert in_colour(same) is None
    same[2, 1, 0] += 9
    assert in_colour(same) is same


# ------------------------------------------------------------------------------ product files


def part(tmp_path: Path, colour: str) -> PartConfig:
    path = tmp_path / "part.yaml"
    path.write_text((DATA / "part.yaml").read_text() + colour + "\n")
    return config.load_part(path)


def test_a_colour_in_a_product_file_reaches_the_detector(tmp_path: Path) -> None:
    wanted = part(tmp_path, "colour: {hue_deg: [340, 14], saturation: [0.35, 1.0]}").model().colour
    assert wanted == ColourRange(hue_deg=(340.0, 14.0), saturation=(0.35, 1.0))
    assert part(tmp_path, "").model().colour is None


@pytest.mark.parametrize(
    ("colour", "said"),
    [
        ("colour: {hue_deg: [10, 370]}", "colour.hue_deg.1: Input should be less than or equal to 360"),
        ("colour: {hue_deg: [20, 20]}", "colour: hue_deg is empty: from and to are both 20.0"),
        ("colour: {saturation: [0.5, 0.2]}", "colour: saturation is empty: min 0.5 is not below max 0.2"),
        ("colour: {value: [0, 255]}", "colour.value.1: Input should be less than or equal to 1"),
        ("colour: {}", "colour: every colour would count"),
        ("colour: wood", "colour: Input should be a valid dictionary"),
        ("colour: {hue: [20, 30]}", "colour.hue: unknown key"),
    ],
)
def test_a_colour_that_cannot_be_meant_is_refused(tmp_path: Path, colour: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        part(tmp_path, colour)
    assert said in str(caught.value)
    assert str(caught.value).startswith(f"{tmp_path / 'part.yaml'}:7:")


def cell_file(folder: Path, *, tuning: str = "", grey: bool = True) -> Path:
    """The drawn cell with a coloured product; its left camera replays the drawn picture."""
    for name in ("calibration.json", "left.png", "right.png"):
        (folder / name).write_bytes((DATA / name).read_bytes())
    if not grey:
        cv2.imwrite(str(folder / "left.png"), tinted(DATA / "left.png"))
    text = (DATA / "cell.yaml").read_text()
    old = "length_m: 0.080, length_tolerance_m: 0.004, diameter_m: 0.004}"
    assert old in text
    path = folder / "cell.yaml"
    path.write_text(text.replace(old, f"{old[:-1]}, {WOOD}}}") + tuning)
    return path


def tinted(path: Path) -> Pixels:
    """A grey picture as if everything in it were of wood."""
    read = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert read is not None
    wood = np.rint(read[..., None] * np.array([0.7, 0.97, 1.08])).clip(0, 255)
    return np.asarray(wood, np.uint8)


def test_a_check_refuses_a_grey_camera_for_a_product_told_by_colour(tmp_path: Path) -> None:
    path = cell_file(tmp_path)
    with pytest.raises(ConfigError) as caught:
        wiring.check(config.load(path), str(path))
    assert "part stick-80: it is told by its colour, but cameras.left gives grey pictures" in str(
        caught.value
    )


def test_a_check_accepts_a_colour_camera_and_one_whose_pictures_are_not_there_yet(tmp_path: Path) -> None:
    path = cell_file(tmp_path, grey=False)
    wiring.check(config.load(path), str(path))
    (tmp_path / "left.png").unlink()
    wiring.check(config.load(path), str(path))


def test_the_published_method_and_a_colour_do_not_go_together(tmp_path: Path) -> None:
    path = cell_file(tmp_path, tuning="tuning: {method: published}\n", grey=False)
    with pytest.raises(ConfigError, match="the published method does not look at colour"):
        config.load(path)


# ------------------------------------------------------------------------------ looks and picks


def test_a_pick_gives_the_detector_the_left_picture_in_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[Pixels | None] = []

    def locate(*_: object, colour_left: Pixels | None = None, **__: object) -> Scene:
        given.append(colour_left)
        return scene(stick((-0.04, -0.45, 0.022), (0.04, -0.45, 0.022)))

    monkeypatch.setattr(cycle, "locate", locate)
    cell = bench().open()
    coloured = cell.station.parts[0].model_copy(update={"colour": ColourConfig(hue_deg=(14.0, 62.0))})
    station = replace(cell.station, parts=(coloured, cell.station.parts[1]))
    pixels = tinted(DATA / "left.png")
    cell.left.answers[:] = [pixels]
    run_order(station, order(), StopToken(cell.clock))
    (seen,) = given
    assert seen is not None
    assert np.array_equal(seen, pixels)


def test_a_grey_picture_of_a_product_told_by_colour_ends_the_look_not_the_pick() -> None:
    cell = bench().open()
    coloured = cell.station.parts[0].model_copy(update={"colour": ColourConfig(hue_deg=(14.0, 62.0))})
    station = replace(cell.station, parts=(coloured, cell.station.parts[1]))
    with pytest.raises(
        PictureUnusable, match=r"camera\.left: picture 1 is grey, but part stick-80 is told by"
    ):
        run_order(station, order(), StopToken(cell.clock))
    assert len(cell.robot.targets) == 1, "the arm went out of the view and nowhere else"


def test_a_look_at_grey_files_for_a_product_told_by_colour_is_refused(tmp_path: Path) -> None:
    product = tmp_path / "part.yaml"
    product.write_text((DATA / "part.yaml").read_text() + WOOD + "\n")
    arguments = (DATA / "right.png", DATA / "calibration.json", product)
    with pytest.raises(UsageError, match=r"left\.png: the picture is grey, but part stick-80 is told by"):
        look.from_files(DATA / "left.png", *arguments, Tuning())
    coloured = tmp_path / "coloured.png"
    cv2.imwrite(str(coloured), tinted(DATA / "left.png"))
    assert look.from_files(coloured, *arguments, Tuning()).part.colour is not None
    with pytest.raises(UsageError, match="the published method does not look at colour"):
        look.from_files(coloured, *arguments, Tuning(method="published"))


# ------------------------------------------------------------------------------ scene folders


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "rigs").mkdir()
    (tmp_path / "rigs" / "bench.json").write_text(json.dumps(RIG), encoding="utf-8")
    return tmp_path


def test_an_unknown_word_is_told_with_those_there_are(root: Path) -> None:
    picture = bars(0, np.zeros((0, 2, 2)))
    write_scene(root, "odd", picture, picture, {**STICK, "colour": "mauve"})
    with pytest.raises(UsageError, match="colour 'mauve' is not known; use one of wood, red, yellow, green,"):
        evaluate(root, root / "out", "default", only=("odd",))


def test_grey_scenes_are_looked_at_without_the_colour_and_say_so(root: Path) -> None:
    ends = np.array([[[300, 200], [450, 200]]], np.float64)
    write_scene(root, "grey", bars(0, ends), bars(120, ends), {**STICK, "colour": "wood"})
    evaluate(root, root / "out", "published")
    found = result(root / "out", "grey")
    assert found["notes"] == ["colour ignored: the left picture is grey"]
    assert found["detections"]


def test_scenes_without_a_colour_have_nothing_to_note(root: Path) -> None:
    ends = np.array([[[300, 200], [450, 200]]], np.float64)
    write_scene(root, "plain", bars(0, ends), bars(120, ends))
    evaluate(root, root / "out", "published")
    assert result(root / "out", "plain")["notes"] == []


def test_the_recipe_has_the_limits_of_every_word() -> None:
    page = (Path(__file__).parents[3] / "docs" / "recipes" / "colour.md").read_text(encoding="utf-8")
    told = {
        row[1].strip(): row[2:5] for row in (line.split("|") for line in page.splitlines()) if len(row) == 6
    }
    for word, wanted in WORDS.items():
        for cell, limits, anything in zip(
            told[word],
            (wanted.hue_deg, wanted.saturation, wanted.value),
            (ColourRange().hue_deg, ColourRange().saturation, ColourRange().value),
            strict=True,
        ):
            written = tuple(float(number) for number in cell.split(",")) if cell.strip() else anything
            assert written == limits, word
