"""What the cameras in the virtual machine see: rendered piles of sticks, at several exposures."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from drivers.sim.cell import load_world
from drivers.sim.optics import calibration_text, eyes
from drivers.sim.render import Lighting, Renderer
from drivers.sim.world import World
from drivers.types import Pixels
from tests.lab.vm.numbered import SMALL

ROOT: Final = Path(__file__).parents[3]
WORLD: Final = ROOT / "configs" / "demo" / "world.yaml"
RIGHT_EXPOSURE: Final = 50
"""At which the picture is as rendered; units of 100 us, as webcams count."""
EXPOSURES: Final = (1, 12, 25, 50, 100, 156, 5000)
STICKS: Final = 6
SEED: Final = 11
DARK, BRIGHT = 30, 90
"""Of the blocks that hold the number: apart enough to be read, too faint to be taken for wood."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scenery:
    """Folders for the two cameras, their calibration, and where the sticks lie: axis ends (N, 2, 3) m, base
    frame."""

    left: Path
    right: Path
    calibration: Path
    ends_m: npt.NDArray[np.float64]


def make(folder: Path) -> Scenery:
    """Render one pile for both eyes into ``folder``."""
    layout = load_world(WORLD)
    snapshot = World(layout, seed=SEED, count=STICKS).snapshot()
    light = Lighting(layout).of(snapshot)
    for eye, name in zip(eyes(layout.cameras), ("left", "right"), strict=True):
        picture = Renderer(eye, layout, seed=1).picture(snapshot, light)
        (folder / name).mkdir(parents=True)
        _write(folder / name, picture)
    calibration = folder / "calibration.json"
    known = json.loads(calibration_text(layout.cameras, layout.arm))
    known.pop("cameras", None)  # it is to serve whatever camera shows these pictures
    calibration.write_text(json.dumps(known), encoding="utf-8")
    ends = np.array([stick.ends for stick in snapshot.lying], np.float64)
    return Scenery(left=folder / "left", right=folder / "right", calibration=calibration, ends_m=ends)


def _write(folder: Path, picture: Pixels) -> None:
    (folder / "small").mkdir()
    for exposure in EXPOSURES:
        exposed = np.asarray(cv2.convertScaleAbs(picture, alpha=exposure / RIGHT_EXPOSURE), np.uint8)
        (folder / f"{exposure}.jpg").write_bytes(_jpeg(exposed))
        small = np.asarray(cv2.resize(exposed, SMALL, interpolation=cv2.INTER_AREA), np.uint8)
        (folder / "small" / f"{exposure}.jpg").write_bytes(_jpeg(small))
    cells = np.full((16, 32, 3), DARK, np.uint8)
    cells[:, 16:] = BRIGHT
    (folder / "cells.jpg").write_bytes(_jpeg(cells))
    raw = cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_YUY2)
    (folder / "raw.yuyv").write_bytes(np.ascontiguousarray(raw).tobytes())


def _jpeg(picture: Pixels) -> bytes:
    # a restart marker after every block: each can then be exchanged without decoding
    options = [cv2.IMWRITE_JPEG_QUALITY, 90, cv2.IMWRITE_JPEG_RST_INTERVAL, 1]
    done, content = cv2.imencode(".jpg", picture, options)
    assert done
    return content.tobytes()
