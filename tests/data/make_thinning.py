"""Makes thinning.npz: masks and what OpenCV's own Zhang-Suen thinning leaves of them.

Needs a Python with opencv-contrib-python-headless (``cv2.ximgproc``), scipy and scikit-image, in an
environment of its own because that package and the project's OpenCV are one import name:
``python tests/data/make_thinning.py``. Prints what has changed; without a change the file stays.

Masks: noise at five densities, its closing to blobs, drawn sticks at all angles, the rendered picture of
this folder, and three photographs that scikit-image carries (coins, a page of text, printed words).
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage
from skimage import data

HERE = Path(__file__).parent
Bools = npt.NDArray[np.bool_]


def masks() -> dict[str, Bools]:
    """All masks by name."""
    random = np.random.default_rng(1984)
    made: dict[str, Bools] = {}
    for percent in (10, 30, 50, 70, 90):
        made[f"noise_{percent}"] = random.random((90, 131)) < percent / 100
    for sigma in (1.5, 3.0, 6.0):
        made[f"blobs_{sigma}"] = ndimage.gaussian_filter(random.random((120, 200)), sigma, mode="wrap") > 0.5
    made["sticks"] = _sticks(random)
    left = cv2.imread(str(HERE / "left.png"), cv2.IMREAD_GRAYSCALE)
    assert left is not None
    photographs = {name: getattr(data, name)() for name in ("coins", "page", "text")}
    for name, grey in {"rendered": left, **photographs}.items():
        _, bright = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
        made[name] = bright > 0 if name in ("rendered", "coins") else bright == 0
    return made


def _sticks(random: np.random.Generator) -> Bools:
    canvas = np.zeros((300, 400), np.uint8)
    for number in range(36):
        middle = random.uniform((40, 40), (360, 260))
        turn = np.radians(5 * number)
        half = 45 * np.array([np.cos(turn), np.sin(turn)])
        ends = np.rint([middle - half, middle + half]).astype(int).tolist()
        cv2.line(canvas, tuple(ends[0]), tuple(ends[1]), 255, 3 + number % 5)
    return canvas > 0


def zhang_suen(mask: Bools) -> Bools:
    """OpenCV's, with a frame of background: it leaves the outermost pixels alone."""
    framed = np.pad(mask, 1).astype(np.uint8) * 255
    contrib = cv2.ximgproc  # type: ignore[attr-defined]  # not in the OpenCV that mypy sees
    thin = contrib.thinning(framed, thinningType=contrib.THINNING_ZHANGSUEN)
    return np.asarray(thin[1:-1, 1:-1] > 0)


def main() -> None:
    """Writes the file when its content would change."""
    columns: dict[str, npt.NDArray[np.generic]] = {}
    for name, mask in masks().items():
        columns[f"{name}.shape"] = np.array(mask.shape)
        columns[f"{name}.mask"] = np.packbits(mask)
        columns[f"{name}.skeleton"] = np.packbits(zhang_suen(mask))
    path = HERE / "thinning.npz"
    if path.exists():
        with np.load(path) as old:
            changed = sorted(set(old.files) ^ set(columns))
            changed += [k for k in old.files if k in columns and not np.array_equal(old[k], columns[k])]
        told = ", ".join(changed) or "nothing changed"
        sys.stdout.write(f"opencv {cv2.__version__}: {told}\n")
        if not changed:
            return
    np.savez_compressed(path, allow_pickle=False, **columns)


if __name__ == "__main__":
    main()
