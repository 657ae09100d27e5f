"""`mikado calibrate cameras` on folders and through a rig: what is used, refused, said, written."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from cell import calibration
from cell.cli import main
from cell.commission.live_views import Wish, watch
from cell.errors import CalibrationError
from drivers.errors import DeviceTimeout
from drivers.types import Frame, FramePair
from tests.fakes.clock import FakeClock
from tests.reference.boards import CHARUCO, CHESSBOARD, PLACES, STEREO, pair
from vision.boards import Board
from vision.types import Grey


def board_file(folder: Path, board: Board, **more: float) -> Path:
    words = [
        f"kind: {board.kind}",
        f"columns: {board.columns}",
        f"rows: {board.rows}",
        f"pitch_m: {board.pitch_m}",
    ]
    if board.kind == "charuco":
        words += [f"marker_m: {board.marker_m}", f"dictionary: {board.dictionary}"]
    words += [f"{key}: {value}" for key, value in more.items()]
    path = folder / "board.yaml"
    path.write_text("\n".join(words) + "\n", encoding="utf-8")
    return path


def save(folder: Path, name: str, left: Grey, right: Grey) -> None:
    folder.mkdir(exist_ok=True)
    for eye, picture in (("left", left), ("right", right)):
        cv2.imwrite(str(folder / f"{eye}_{name}.png"), picture)


@pytest.fixture
def images(tmp_path: Path) -> Path:
    for n in range(len(PLACES)):
        save(tmp_path / "images", f"{n:02d}", *pair(CHESSBOARD, n))
    return tmp_path / "images"


def calibrate(folder: Path, images: Path, board: Path, *more: str) -> int:
    out = folder / "rig.json"
    return main(
        ["calibrate", "cameras", "--board", str(board), "--images", str(images), "--out", str(out), *more]
    )


def test_a_folder_becomes_a_calibration_the_cell_reads(
    tmp_path: Path, images: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    board = board_file(tmp_path, CHESSBOARD, bar_m=0.1, measured_bar_m=0.1)

    plot, opencv = tmp_path / "plot.png", tmp_path / "rig.yaml"
    assert calibrate(tmp_path, images, board, "--plot", str(plot), "--opencv", str(opencv)) == 0

    known = calibration.load(tmp_path / "rig.json")
    assert np.allclose(
        known.stereo.right_from_left.translation, STEREO.right_from_left.translation, atol=1e-3
    )
    said = json.loads((tmp_path / "rig.json").read_text(encoding="utf-8"))
    assert said["scale_checked"] is True
    assert said["date"].startswith("20")
    assert len(said["sigma"]["left"]) == 9
    assert {view["name"] for view in said["views"]} == {f"{n:02d}" for n in range(len(PLACES))}
    assert cv2.imread(str(plot)) is not None
    again = calibration.load(opencv)
    assert np.allclose(again.stereo.left.matrix, known.stereo.left.matrix)
    assert "reprojection rms" in capsys.readouterr().out


def test_blurred_cut_repeated_and_single_pictures_are_refused_by_name(
    tmp_path: Path, images: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left, right = pair(CHESSBOARD, 2)
    save(images, "blurred", *(np.asarray(cv2.GaussianBlur(p, (0, 0), 2.0), np.uint8) for p in (left, right)))
    cut = [np.where(np.arange(360) < 185, 60, p).astype(np.uint8) for p in pair(CHESSBOARD, 0)]
    save(images, "cut", *cut)
    save(images, "twice", *pair(CHESSBOARD, 3))
    cv2.imwrite(str(images / "left_alone.png"), left)
    (images / "left_torn.png").write_bytes((images / "left_00.png").read_bytes()[:20])
    cv2.imwrite(str(images / "right_torn.png"), np.full_like(right, 90))

    assert calibrate(tmp_path, images, board_file(tmp_path, CHESSBOARD)) == 0

    said = json.loads((tmp_path / "rig.json").read_text(encoding="utf-8"))
    refused = {one["name"]: one["why"] for one in said["refused"]}
    assert "blurred" in refused["blurred"]
    assert "cut" in refused["cut"] or "outside" in refused["cut"]
    assert "repeated: shows the board where view 03 does" in refused["twice"]
    assert "no picture of the other camera" in refused["left_alone.png"]
    assert "not a picture" in refused["torn"]
    assert "SCALE NOT CHECKED" in capsys.readouterr().out
    assert said["scale_checked"] is False


def test_swapped_cameras_are_named_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for n in range(len(PLACES)):
        save(tmp_path / "images", f"{n:02d}", *pair(CHESSBOARD, n)[::-1])

    assert calibrate(tmp_path, tmp_path / "images", board_file(tmp_path, CHESSBOARD)) == 78

    assert "left and right are swapped" in capsys.readouterr().err
    assert not (tmp_path / "rig.json").exists()


def test_a_mirrored_board_is_named_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for n in range(4):
        save(tmp_path / "images", f"{n:02d}", *(np.ascontiguousarray(p[:, ::-1]) for p in pair(CHARUCO, n)))

    assert calibrate(tmp_path, tmp_path / "images", board_file(tmp_path, CHARUCO)) == 78

    assert "mirrored" in capsys.readouterr().out
    assert not (tmp_path / "rig.json").exists()


def test_the_measured_bar_corrects_a_wrong_pitch_that_residuals_do_not_show(
    tmp_path: Path, images: Path
) -> None:
    true_m = float(np.linalg.norm(STEREO.right_from_left.translation))
    rms, baseline = [], []
    # the file says 5 % too much; the bar, 5 % short of what it should be, says so
    wrong = Board(kind="chessboard", columns=8, rows=7, pitch_m=CHESSBOARD.pitch_m * 1.05)
    for more in ({}, {"bar_m": 0.105, "measured_bar_m": 0.100}):
        assert calibrate(tmp_path, images, board_file(tmp_path, wrong, **more)) == 0
        known = calibration.load(tmp_path / "rig.json").stereo
        rms.append(known.rms_px)
        baseline.append(float(np.linalg.norm(known.right_from_left.translation)))

    assert rms[0] == pytest.approx(rms[1], rel=1e-3)
    assert baseline[0] / true_m == pytest.approx(1.05, abs=0.006)
    assert baseline[1] / true_m == pytest.approx(1.00, abs=0.006)


def test_a_baseline_by_the_ruler_names_a_wrong_pitch(
    tmp_path: Path, images: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = Board(kind="chessboard", columns=8, rows=7, pitch_m=CHESSBOARD.pitch_m * 1.05)

    assert calibrate(tmp_path, images, board_file(tmp_path, wrong), "--baseline-mm", "74.2") == 78

    assert "the pitch of the board is wrong" in capsys.readouterr().err
    assert not (tmp_path / "rig.json").exists()


def test_views_of_two_moments_are_refused_and_the_worst_named(
    tmp_path: Path, images: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save(images, "04", pair(CHESSBOARD, 4)[0], pair(CHESSBOARD, 9)[1])

    assert calibrate(tmp_path, images, board_file(tmp_path, CHESSBOARD)) == 78

    said = capsys.readouterr().err
    assert "contradict each other" in said
    assert "04" in said
    assert not (tmp_path / "rig.json").exists()


def test_the_worst_view_is_dropped_on_request(
    tmp_path: Path, images: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left, right = pair(CHESSBOARD, 4)
    save(images, "04", left, np.roll(right, 3, axis=0))
    board = board_file(tmp_path, CHESSBOARD)

    assert calibrate(tmp_path, images, board) == 0
    before = capsys.readouterr().out
    assert calibrate(tmp_path, images, board, "--drop-worst", "1") == 0

    assert "view 04 does not fit the others" in before
    after = capsys.readouterr().out
    assert "dropped: 04" in after
    assert "does not fit" not in after


def test_a_changed_file_is_not_read(tmp_path: Path, images: Path) -> None:
    assert calibrate(tmp_path, images, board_file(tmp_path, CHESSBOARD)) == 0
    path = tmp_path / "rig.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    content["T"][0] *= 1.01
    path.write_text(json.dumps(content), encoding="utf-8")

    with pytest.raises(CalibrationError, match="does not fit its checksum"):
        calibration.load(path)


def test_opencv_files_go_in_and_out(tmp_path: Path, images: Path) -> None:
    assert calibrate(tmp_path, images, board_file(tmp_path, CHESSBOARD)) == 0
    rig, yaml, back = tmp_path / "rig.json", tmp_path / "rig.yml", tmp_path / "back.json"

    assert main(["calibrate", "export", str(rig), str(yaml)]) == 0
    assert main(["calibrate", "import", str(yaml), str(back)]) == 0

    storage = cv2.FileStorage(str(yaml), cv2.FILE_STORAGE_READ)
    first, second = calibration.load(rig).stereo, calibration.load(back).stereo
    assert np.allclose(storage.getNode("K1").mat(), first.left.matrix)
    storage.release()
    assert np.allclose(first.right_from_left.translation, second.right_from_left.translation)
    assert np.allclose(first.right.distortion, second.right.distortion)


class ShownRig:
    """A rig before which a board is held: a list of pairs, then no more pictures."""

    def __init__(self, shown: list[tuple[Grey, Grey]], clock: FakeClock) -> None:
        self._shown, self._clock, self._next = shown, clock, 0

    @property
    def name(self) -> str:
        return "rig"

    def open(self) -> None: ...

    def close(self) -> None: ...

    def grab_pair(self, *, newer_than: float, timeout_s: float) -> FramePair:
        self._clock.turn(0.1)
        if self._next == len(self._shown):
            raise DeviceTimeout("rig", "no pair")
        pictures = self._shown[self._next]
        self._next += 1
        frames = [
            Frame(camera=f"camera.{eye}", pixels=picture, captured_at=self._clock.now(), sequence=self._next)
            for eye, picture in zip(("left", "right"), pictures, strict=True)
        ]
        return FramePair(left=frames[0], right=frames[1])


def test_live_a_view_is_kept_when_the_board_stands_still_and_once_only(tmp_path: Path) -> None:
    still, passing, second = pair(CHESSBOARD, 0), pair(CHESSBOARD, 2), pair(CHESSBOARD, 3)
    shown = [still] * 5 + [passing] * 1 + [second] * 4 + [still] * 4
    clock = FakeClock()
    said: list[str] = []

    wish = Wish(views=9, save=tmp_path / "kept", deadline_s=60.0)
    collected = watch(ShownRig(shown, clock), CHESSBOARD, wish, clock, 1.0, said.append)

    assert [view.name for view in collected.views] == ["01", "02"]
    assert "seen before: move the board" in said
    assert any("view 01 kept; missing: " in words for words in said)
    assert sorted(path.name for path in (tmp_path / "kept").iterdir()) == [
        "left_01.png", "left_02.png", "right_01.png", "right_02.png",
    ]  # fmt: skip
