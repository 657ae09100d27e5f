"""`mikado product teach`: one part of known length becomes a product by which others are found."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from cell import config
from cell.calibration import Calibration
from cell.cli import main
from cell.commission import teach
from cell.errors import UsageError
from tests.reference.sticks import TABLE, Stick, lying, pair, rig
from vision.locate import locate
from vision.types import Grey, Tuning

SHARED = Path(__file__).parents[4] / "shared" / "data" / "scenes-dev"


def shown(sticks: list[Stick], empty: list[Stick] | None = None) -> teach.Shown:
    left, right = pair(sticks)
    known = Calibration(
        path=Path("drawn"), stereo=rig(), base_from_camera=None, table=TABLE, units="m", cameras=None
    )
    return teach.Shown(
        left=left,
        right=right,
        empty=None if empty is None else pair(empty, seed=5),
        known=known,
        table=TABLE,
        tuning=Tuning(),
    )


ONE = lying(0.01, 0.005, 70.0)


def test_width_band_and_end_correction_are_learned_from_one_part() -> None:
    taught = teach.teach(shown([ONE]), 0.1, 3, "rod")

    assert taught.part.diameter_m == pytest.approx(0.004, rel=0.15)
    assert taught.length_m == pytest.approx(0.1, abs=0.001)
    low, high = taught.part.band or (0, 0)
    assert 45 < low < 160
    assert high == 255
    assert taught.thinned_m is not None
    assert taught.part.thinning_end_m == pytest.approx((0.1 - taught.thinned_m) / 2, abs=1e-5)


def test_with_the_correction_the_published_method_measures_the_true_length() -> None:
    taught = teach.teach(shown([ONE]), 0.1, 3, "rod")
    look = shown([lying(0.01, 0.0, 120.0)])
    tuning = taught.part.tuned(Tuning(method="published"))

    scene = locate(look.left, look.right, look.known.stereo, taught.part.model(), tuning, TABLE)

    assert tuning.band == taught.part.band
    offered = scene.candidates[0]
    corrected = offered.length_m + 2 * taught.part.thinning_end_m
    assert offered.offered
    assert abs(corrected - 0.1) <= abs(offered.length_m - 0.1) + 1e-6
    assert corrected == pytest.approx(0.1, abs=0.003)


def on_a_bright_table(picture: Grey) -> Grey:
    """The drawn table as the floor of a tray in a larger, brighter one."""
    bright = picture.copy()
    bright[:120] = bright[-110:] = bright[:, :150] = bright[:, -150:] = 130
    return bright


def test_a_table_brighter_than_the_tray_takes_nothing_away() -> None:
    look = shown([ONE], empty=[])
    assert look.empty is not None
    look = replace(
        look,
        left=on_a_bright_table(look.left),
        right=on_a_bright_table(look.right),
        empty=(on_a_bright_table(look.empty[0]), on_a_bright_table(look.empty[1])),
    )
    taught = teach.teach(look, 0.1, 3, "rod")
    assert taught.part.diameter_m == pytest.approx(0.004, rel=0.15)


def test_a_tray_in_which_nothing_was_put_is_said_to_be_empty() -> None:
    with pytest.raises(UsageError, match="those of the empty tray"):
        teach.teach(shown([], empty=[]), 0.1, 3, "rod")


def test_the_empty_tray_takes_other_things_away() -> None:
    other = lying(-0.06, -0.05, 100.0)

    with pytest.raises(UsageError, match="long things are seen"):
        teach.teach(shown([ONE, other]), 0.1, 1, "rod")

    assert teach.teach(shown([ONE, other], empty=[other]), 0.1, 1, "rod").length_m == pytest.approx(
        0.1, abs=0.001
    )


def test_a_wrong_length_is_refused_with_what_is_seen() -> None:
    with pytest.raises(UsageError, match=r"no part of 120.0 mm|by the cameras the part is"):
        teach.teach(shown([ONE]), 0.12, 1, "rod")


def test_an_empty_table_is_refused() -> None:
    with pytest.raises(UsageError, match=r"no part is seen|no thin part is seen"):
        teach.teach(shown([]), 0.1, 1, "rod")


def alone(scene: Path, keep: int) -> tuple[Grey, Grey]:
    """A rendered pair in which all objects but one are painted over with the table beside them."""
    pictures = []
    for eye in ("left", "right"):
        grey = np.asarray(cv2.imread(str(scene / f"{eye}.png"), cv2.IMREAD_GRAYSCALE))
        ids = np.asarray(cv2.imread(str(scene / f"ids_{eye}.png"), cv2.IMREAD_UNCHANGED))[..., 0]
        away = ((ids != 0) & (ids != keep + 1)).astype(np.uint8)
        away = cv2.dilate(away, np.ones((9, 9), np.uint8))
        away[cv2.dilate((ids == keep + 1).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0] = 0
        pictures.append(np.asarray(cv2.inpaint(grey, away, 5, cv2.INPAINT_TELEA), dtype=np.uint8))
    return pictures[0], pictures[1]


@pytest.mark.shared_data
@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared scenes are not here")
def test_a_rendered_part_teaches_a_product_that_finds_all_of_another_scene(tmp_path: Path) -> None:
    rig_file = SHARED / "rigs" / "dev-webcam.json"
    for eye, grey in zip(("left", "right"), alone(SHARED / "scenes" / "A1", 0), strict=True):
        cv2.imwrite(str(tmp_path / f"{eye}.png"), grey)
    product = tmp_path / "stick.yaml"

    assert main([
        "product", "teach", "--left", str(tmp_path / "left.png"), "--right", str(tmp_path / "right.png"),
        "--calibration", str(rig_file), "--length-mm", "100", "--name", "stick", "--out", str(product),
    ]) == 0  # fmt: skip
    scene = SHARED / "scenes" / "B2"
    assert main([
        "look", "--left", str(scene / "left.png"), "--right", str(scene / "right.png"),
        "--calibration", str(rig_file), "--product", str(product), "--out", str(tmp_path / "out"),
    ]) == 0  # fmt: skip

    assert config.load_part(product).diameter_m == pytest.approx(0.0038, rel=0.12)
    told = json.loads((tmp_path / "out" / "look.json").read_text(encoding="utf-8"))
    truth = json.loads((scene / "gt.json").read_text(encoding="utf-8"))
    assert len(told["candidates"]) >= len(truth["objects"])


@pytest.mark.parametrize(
    ("stated_m", "fits"), [(0.09, False), (0.097, True), (0.1, True), (0.104, True), (0.11, False)]
)
def test_a_length_that_thinning_contradicts_is_refused(stated_m: float, fits: bool) -> None:
    # 96.5 mm are left of a stick of 100 mm by 3.8 mm
    if fits:
        teach._refuse_other_length(stated_m, 0.0965, 0.0038)
    else:
        with pytest.raises(UsageError, match=r"thinning leaves 96\.5 mm"):
            teach._refuse_other_length(stated_m, 0.0965, 0.0038)
