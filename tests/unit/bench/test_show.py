"""A heap drawn: the pieces it shows, and the colours of what was found, wrong and missed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench import own
from bench.show import BLUE, GREEN, RED, lines_of, main, picture, pixels

CASE = own.cases("A", 1, 11)[0]


def test_what_was_found_is_blue_and_with_another_truth_red_beside_green() -> None:
    moved = tuple(replace(part, ends=part.ends + np.array([0.02, 0.0, 0.0])) for part in CASE.truth.parts)
    other = replace(CASE, truth=replace(CASE.truth, parts=moved))

    assert [colour for _, colour in lines_of(CASE)] == [BLUE] * len(CASE.truth.parts)
    colours = [colour for _, colour in lines_of(other)]
    assert colours.count(RED) == colours.count(GREEN) == len(moved)


def test_the_axis_of_a_part_is_drawn_on_bright_pixels_of_both_pictures() -> None:
    for right, grey in ((False, CASE.left), (True, CASE.right)):
        for part in CASE.truth.parts:
            column, row = pixels(part.ends, CASE.stereo, right).mean(axis=0)
            assert grey[round(row), round(column)] > np.median(grey) + 30


def test_a_part_alone_is_enlarged_and_the_whole_is_as_large_as_both_pictures() -> None:
    whole, part = picture(CASE, None, 1), picture(CASE, 0, 4)

    assert whole.shape[0] == 2 * CASE.left.shape[0] + 4
    assert whole.shape[1] == 2 * (CASE.left.shape[1] + 6)
    assert max(part.shape) < 4 * max(whole.shape)
    assert (part == BLUE).all(axis=2).any()


def test_the_command_writes_a_picture_and_refuses_a_part_that_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["show", "A", "1", "--seed", "11", "--out", str(tmp_path / "a.png"), "--part"]
    monkeypatch.setattr("sys.argv", [*asked, "0"])
    main()
    assert cv2.imread(str(tmp_path / "a.png")) is not None

    monkeypatch.setattr("sys.argv", [*asked, "99"])
    with pytest.raises(SystemExit):
        main()
    assert "--part 99: A-1 has parts 0 to" in capsys.readouterr().err


@pytest.mark.parametrize(("words", "said"), [(["A"], "needs its number"), (["A", "1"], "--seed")])
def test_without_a_number_or_a_seed_it_says_what_is_missing(
    words: list[str], said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["show", *words, "--out", "a.png"])

    with pytest.raises(SystemExit):
        main()

    assert said in capsys.readouterr().err
