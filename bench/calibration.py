"""The camera calibration against truth, and beside OpenCV's own sample on real pictures.

``python -m bench.calibration [--shared ../shared/data]``

Rendered views: reprojection, and how far the computed cameras place the true points of that rig's scenes.
Real chessboard pairs: the procedure of OpenCV's ``samples/cpp/stereo_calib.cpp`` by its documented calls, and
ours, on the same pictures, both judged by the sample's own measure: the mean over corners of the sum of both
distances to the epipolar lines, after undistortion. Its reprojection counts both cameras together.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import cast

import cv2
import numpy as np

from bench.tables import Sheet, show
from cell import calibration
from vision.boards import Board, Corners, corner_points, detect
from vision.calibrate import View, calibrate
from vision.stereo import project, rectification, rectify_points, triangulate
from vision.types import CameraModel, Floats, Grey, StereoModel, Transform

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
REAL = Board(kind="chessboard", columns=10, rows=7, pitch_m=0.025)


def grey_of(path: Path) -> Grey:
    """A picture file."""
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)


def pairs(folder: Path, pattern: str) -> list[tuple[Path, Path]]:
    """Left and right files of a folder."""
    return [
        (left, left.with_name(left.name.replace("left", "right"))) for left in sorted(folder.glob(pattern))
    ]


def views_of(files: list[tuple[Path, Path]], board: Board) -> list[View]:
    """What is seen of a board."""
    return [
        View(name=left.stem, left=detect(grey_of(left), board), right=detect(grey_of(right), board))
        for left, right in files
    ]


def rendered(shared: Path, kind: str) -> tuple[str, ...]:
    """One row: the rendered views of a rig against its truth."""
    folder = shared / "scenes-dev" / "calibration" / f"calib-{kind}"
    told = json.loads((folder / "board.json").read_text(encoding="utf-8"))
    board = Board(
        kind=told["type"],
        columns=told["squares"][0],
        rows=told["squares"][1],
        pitch_m=told["square"] / 1e3,
        marker_m=told.get("marker", 0.0) / 1e3,
        dictionary=told.get("dict", ""),
    )
    answer = calibrate(views_of(pairs(folder, "left_*.png"), board), board)
    true = calibration.load(shared / "scenes-dev" / "rigs" / f"dev-{kind}.json").stereo
    points = []
    for file in sorted((shared / "scenes-dev").glob("scenes/*/gt.json")):
        scene = json.loads(file.read_text(encoding="utf-8"))
        if scene["rig"] == f"dev-{kind}":
            points += [node["cam"] for thing in scene["objects"] for node in thing["nodes"]]
    points_m = np.array(points) / 1e3
    rect = rectification(answer.stereo)
    left, right = project(points_m, true)
    there = triangulate(rectify_points(left, rect, "left"), rectify_points(right, rect, "right"), rect)
    off = 1e3 * np.linalg.norm(there - points_m, axis=1)
    rows = np.abs(answer.rows_px)
    return (
        f"{kind}, {board.kind}",
        f"{len(answer.views)}",
        f"{answer.left_rms_px:.3f} / {answer.right_rms_px:.3f}",
        f"{rows.mean():.3f} / {np.percentile(rows, 95):.3f}",
        f"{len(points_m)}",
        f"{1e3 * np.median(points_m[:, 2]):.0f}",
        f"{np.median(off):.3f} / {np.percentile(off, 95):.3f}",
    )


def sample(files: list[tuple[Path, Path]], board: Board) -> tuple[StereoModel, list[View]]:
    """OpenCV's stereo_calib: corners, one focal length for both, no tangential distortion, rational model."""
    size = (board.columns - 1, board.rows - 1)
    found: list[View] = []
    height, width = grey_of(files[0][0]).shape
    for left, right in files:
        seen: list[Corners] = []
        for path in (left, right):
            grey = grey_of(path)
            good, corners = cv2.findChessboardCorners(
                grey, size, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
            )
            if not good:
                break
            fine = cv2.cornerSubPix(grey, corners, (11, 11), (-1, -1), (3, 30, 0.01))
            seen.append(
                Corners(
                    ids=np.arange(board.corner_count),
                    pixels=np.asarray(fine, dtype=np.float64).reshape(-1, 2),
                    spacing_px=1.0,
                    edge_px=1.0,
                    contrast=255.0,
                    width_px=width,
                    height_px=height,
                )
            )
        if len(seen) == 2:
            found.append(View(name=left.stem, left=seen[0], right=seen[1]))
    # in squares, as the sample has them: its end of iterations depends on the unit
    points = [(corner_points(board) / board.pitch_m).astype(np.float32)] * len(found)
    sides = [
        [cast(Corners, view.left).pixels.astype(np.float32) for view in found],
        [cast(Corners, view.right).pixels.astype(np.float32) for view in found],
    ]
    first = [
        cv2.initCameraMatrix2D(
            objectPoints=points, imagePoints=side, imageSize=(width, height), aspectRatio=0
        )
        for side in sides
    ]
    rms, k1, d1, k2, d2, turn, shift, _, _ = cv2.stereoCalibrate(
        objectPoints=points,
        imagePoints1=sides[0],
        imagePoints2=sides[1],
        cameraMatrix1=first[0],
        distCoeffs1=np.zeros(8),
        cameraMatrix2=first[1],
        distCoeffs2=np.zeros(8),
        imageSize=(width, height),
        flags=cv2.CALIB_FIX_ASPECT_RATIO
        | cv2.CALIB_ZERO_TANGENT_DIST
        | cv2.CALIB_USE_INTRINSIC_GUESS
        | cv2.CALIB_SAME_FOCAL_LENGTH
        | cv2.CALIB_RATIONAL_MODEL
        | cv2.CALIB_FIX_K3
        | cv2.CALIB_FIX_K4
        | cv2.CALIB_FIX_K5,
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-5),
    )

    return _stereo((k1, d1, k2, d2, turn, shift), float(rms), (width, height), board), found


def separately(views: list[View], board: Board) -> StereoModel:
    """OpenCV the way its documentation advises: each camera by itself, then how they stand to each other."""
    lefts = [view.left for view in views if view.left is not None and view.right is not None]
    rights = [view.right for view in views if view.left is not None and view.right is not None]
    size = (lefts[0].width_px, lefts[0].height_px)
    points = [(corner_points(board) / board.pitch_m).astype(np.float32)] * len(lefts)
    sides = [[corners.pixels.astype(np.float32) for corners in side] for side in (lefts, rights)]
    alone = [
        cv2.calibrateCamera(
            objectPoints=points,
            imagePoints=side,
            imageSize=size,
            cameraMatrix=np.eye(3),
            distCoeffs=np.zeros(5),
        )
        for side in sides
    ]
    rms, k1, d1, k2, d2, turn, shift, _, _ = cv2.stereoCalibrate(
        objectPoints=points,
        imagePoints1=sides[0],
        imagePoints2=sides[1],
        cameraMatrix1=alone[0][1],
        distCoeffs1=alone[0][2],
        cameraMatrix2=alone[1][1],
        distCoeffs2=alone[1][2],
        imageSize=size,
        flags=cv2.CALIB_FIX_INTRINSIC,
    )
    return _stereo((k1, d1, k2, d2, turn, shift), float(rms), size, board)


def _stereo(answer: tuple[object, ...], rms_px: float, size: tuple[int, int], board: Board) -> StereoModel:
    """OpenCV's matrices as our record, squares as metres."""
    k1, d1, k2, d2, turn, shift = (np.asarray(part, dtype=np.float64) for part in answer)

    def model(matrix: Floats, distortion: Floats) -> CameraModel:
        numbers = distortion.reshape(-1)[:8]
        return CameraModel(matrix=matrix, distortion=numbers, width_px=size[0], height_px=size[1])

    return StereoModel(
        left=model(k1, d1),
        right=model(k2, d2),
        right_from_left=Transform(rotation=turn, translation=shift.ravel() * board.pitch_m),
        rms_px=rms_px,
    )


def epipolar_px(stereo: StereoModel, views: list[View]) -> float:
    """The sample's measure: mean over corners of both distances to the epipolar lines, undistorted."""
    turn, shift = stereo.right_from_left.rotation, stereo.right_from_left.translation
    x, y, z = shift
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    fundamental = np.linalg.inv(stereo.right.matrix).T @ cross @ turn @ np.linalg.inv(stereo.left.matrix)
    off = []
    for view in views:
        if view.left is None or view.right is None:
            continue
        homogeneous: list[Floats] = []
        for corners, camera in ((view.left, stereo.left), (view.right, stereo.right)):
            flat = cv2.undistortPoints(
                corners.pixels.reshape(-1, 1, 2), camera.matrix, camera.distortion, P=camera.matrix
            )
            homogeneous.append(np.column_stack([np.asarray(flat).reshape(-1, 2), np.ones(len(corners.ids))]))
        left, right = homogeneous
        for lines, points in ((left @ fundamental.T, right), (right @ fundamental, left)):
            off.append(np.abs(np.sum(lines * points, axis=1)) / np.hypot(lines[:, 0], lines[:, 1]))
    return float(np.mean(np.concatenate(off)) * 2.0)


def rows_px(stereo: StereoModel, views: list[View]) -> Floats:
    """Row differences after our rectification."""
    rect = rectification(stereo)
    off = [
        rectify_points(view.left.pixels, rect, "left")[:, 1]
        - rectify_points(view.right.pixels, rect, "right")[:, 1]
        for view in views
        if view.left is not None and view.right is not None
    ]
    return np.abs(np.concatenate(off))


def real(shared: Path) -> tuple[tuple[str, ...], ...]:
    """OpenCV's sample, OpenCV camera by camera, and ours on the real chessboard pairs."""
    files = pairs(shared / "real" / "opencv_stereo", "left[01]*.jpg")
    theirs, their_views = sample(files, REAL)
    apart = separately(their_views, REAL)
    our_views = views_of(files, REAL)
    ours = calibrate(our_views, REAL)
    told = []
    for name, stereo, rms, views in (
        ("OpenCV's stereo_calib", theirs, theirs.rms_px, their_views),
        ("OpenCV, camera by camera", apart, apart.rms_px, their_views),
        ("Mikado", ours.stereo, ours.stereo.rms_px, our_views),
    ):
        rows = rows_px(stereo, views)
        told.append(
            (
                name,
                f"{len(views)}",
                f"{rms:.3f}",
                f"{epipolar_px(stereo, views):.3f}",
                f"{rows.mean():.3f} / {np.percentile(rows, 95):.3f}",
                f"{1e3 * np.linalg.norm(stereo.right_from_left.translation):.2f}",
            )
        )
    return tuple(told)


def sheets(shared: Path) -> tuple[Sheet, ...]:
    """Both tables."""
    command = "python -m bench.calibration"
    return (
        Sheet(
            title="calibration from rendered views, against the truth",
            command=command,
            headings=("rig, board", "views", "rms left / right px", "rows mean / 95 % px", "points", "at mm",
                      "off median / 95 % mm"),
            rows=tuple(rendered(shared, kind) for kind in ("webcam", "industrial")),
            notes=("Points: all nodes of all scenes of that rig, seen by the true cameras, placed by ours.",),
        ),
        Sheet(
            title="calibration from real chessboard pairs",
            command=command,
            headings=("by", "pairs", "rms px", "epipolar px", "rows mean / 95 % px", "baseline mm"),
            rows=real(shared),
            notes=("Baseline for a pitch of 25 mm, which nobody measured.",
                "The sample forces one focal length on two cameras that differ.",),
        ),
    )  # fmt: skip


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description="camera calibration against truth and beside OpenCV's sample"
    )
    parser.add_argument("--shared", type=Path, default=SHARED)
    for sheet in sheets(parser.parse_args().shared):
        show(sheet)


if __name__ == "__main__":
    main()
