"""Webcams as the kernel sees them: Debian's uvcvideo in a virtual machine, on USB cameras that are not there.

The machine is emulated in software, on a host that has other things to do: times are upper bounds with room,
and pictures are lost because decoding takes long. That they are lost is not a fault here; that each is
counted is what is shown.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

from cell import calibration
from cell.cli import main
from tests.lab.vm.machine import ROOT, CannotStart
from tests.lab.vm.webcams import CODE, Webcams, plugged_in
from vision import transforms
from vision.types import Floats

DEMO = ROOT / "configs" / "demo" / "cell.yaml"
EXPOSED_US = 5000
NEAR_M = 0.003
FRESH_S = 20.0
NOTICED_S = 5.0
BACK_S = 30.0
WORK_S = 300.0


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Webcams]:
    try:
        with plugged_in(tmp_path_factory.mktemp("lab")) as webcams:
            webcams.work("pictures", "levels", "refusals", "life", "owned", "rate", timeout_s=WORK_S)
            yield webcams
    except CannotStart as reason:
        pytest.skip(f"V4L2 IS NOT TESTED: {reason}")


def test_a_look_on_what_the_webcams_delivered_finds_every_stick(
    lab: Webcams, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = yaml.safe_load(DEMO.read_text())
    for eye in ("left", "right"):
        config["cameras"][eye] = {
            "driver": "replay",
            "folder": str(lab.shared / "out"),
            "pattern": f"{eye}*.png",
            "width_px": 640,
            "height_px": 480,
        }
    config["allow_mixed"] = True
    config["files"]["calibration"] = str(lab.scene.calibration)
    file = tmp_path / "cell.yaml"
    file.write_text(yaml.safe_dump(config))
    assert main(["look", "--config", str(file), "--out", str(tmp_path / "look")]) == 0
    capsys.readouterr()
    seen = json.loads((tmp_path / "look" / "look.json").read_text())
    base = calibration.load(lab.scene.calibration).base_from_camera
    assert base is not None
    found: list[int] = []
    offered: list[int] = []
    for one in seen["candidates"]:
        ends = transforms.apply(base, np.array([one["start_m"], one["end_m"]]))
        found.append(_same_stick(ends, lab.scene.ends_m))
        offered += found[-1:] if one["offered"] else []
    print(f"{len(set(found) - {-1})} of {len(lab.scene.ends_m)} sticks found, {len(offered)} offered")
    assert set(range(len(lab.scene.ends_m))) <= set(found)
    assert -1 not in offered, "a stick is offered where none lies"
    # what lies under another one is found, and rightly not offered
    assert len(set(offered)) >= len(lab.scene.ends_m) - 2


def _same_stick(ends_m: Floats, sticks_m: Floats) -> int:
    """The stick these ends are those of, within 3 mm; -1: none."""
    ways = np.stack([sticks_m, sticks_m[:, ::-1]])
    apart = np.linalg.norm(ways - ends_m, axis=3).max(axis=2).min(axis=0)
    return int(apart.argmin()) if apart.min() < NEAR_M else -1


def test_a_picture_is_exposed_after_it_was_asked_for_and_is_a_new_one(lab: Webcams) -> None:
    frames = lab.told("pictures")["frames"]
    assert isinstance(frames, list)
    assert len(frames) == 4
    assert all(frame["number"] > 0 for frame in frames)
    assert all(0.0 < frame["age_s"] < FRESH_S for frame in frames)
    for eye in ("left", "right"):
        first, second = (frame["number"] for frame in frames if frame["eye"] == eye)
        assert second > first


def test_what_was_set_is_what_the_camera_itself_has_automatics_off(lab: Webcams) -> None:
    # keys: unit and selector of the USB Video Class
    wanted = {
        "1.2": 1,
        "1.3": 0,
        "1.4": 50,
        "1.6": 20,
        "1.8": 0,
        "2.4": 10,
        "2.5": 1,
        "2.10": 5000,
        "2.11": 0,
    }
    for has in lab.told("pictures")["controls"]:  # type: ignore[attr-defined]  # a list, from JSON
        assert {key: has[key] for key in wanted} == wanted


def test_twice_the_exposure_is_a_brighter_picture_in_either_format(lab: Webcams) -> None:
    level = {key: float(str(value)) for key, value in lab.told("levels").items()}
    assert 1.7 < level["5000"] / level["2500"] < 2.3
    assert 1.6 < level["10000"] / level["5000"] < 2.3
    assert abs(level["YUYV"] - level["5000"]) < 3.0


@pytest.mark.parametrize(
    ("what", "kind", "says"),
    [
        ("size", "CommandRejected", "wanted MJPG 800x600, it has MJPG 640x480; it offers MJPG 640x480 at 30"),
        ("rate", "CommandRejected", "rate_hz: wanted 24, it has 30"),
        ("raw rate", "CommandRejected", "rate_hz: wanted 30, it has 5"),
        ("grey", "CommandRejected", "wanted GREY 640x480"),
        ("gain", "CommandRejected", "gain: wanted 101 (from `gain`), it has 100; it takes 0 to 100"),
        (
            "focus",
            "CommandRejected",
            "focus_absolute: wanted 7 (from `focus`), it has 5; it takes 0 to 250 in",
        ),
        ("white balance", "CommandRejected", "wanted 9000 (from `white_balance_k`), it has 6500"),
        ("absent", "DeviceUnavailable", "is not there"),
        ("metadata", "CommandRejected", "-video-index0"),
        ("busy", "DeviceUnavailable", "this program)"),
        ("forbidden", "DeviceUnavailable", "group `video`"),
    ],
)
def test_a_camera_other_than_its_settings_is_refused_with_the_reason(
    lab: Webcams, what: str, kind: str, says: str
) -> None:
    refused = lab.told("refusals")["refused"]
    assert isinstance(refused, dict)
    assert refused[what]["kind"] == kind
    assert says in refused[what]["says"]


def test_every_camera_is_listed_once_by_socket_and_by_serial_number(lab: Webcams) -> None:
    found = lab.told("refusals")["found"]
    assert isinstance(found, list)
    assert [Path(one["device"]).name for one in found] == [
        f"platform-vhci_hcd.0-usb-0:{socket}:1.0-video-index0" for socket in (1, 2)
    ]
    assert "LAB0001" in found[1]["also"][0]
    assert "MJPG 640x480 at 30, 15, 5 Hz" in found[0]["formats"]


def test_a_frozen_camera_is_silent_for_as_long_as_asked_and_then_goes_on(lab: Webcams) -> None:
    told = lab.told("life")
    assert told["silent"] is True
    assert 0.5 <= float(str(told["silent_took_s"])) < 0.5 + NOTICED_S
    assert told["thawed_number_known"] is True
    assert float(str(told["thawed_after_s"])) < NOTICED_S


def test_pictures_cut_short_or_marked_as_spoilt_never_come_out_and_are_counted(lab: Webcams) -> None:
    told = lab.told("life")
    short, spoilt = told["short"], told["spoilt"]
    assert isinstance(short, dict)
    assert isinstance(spoilt, dict)
    assert short["incomplete"] > 0
    # the kernel keeps those to itself: they show as a gap in the numbers
    assert spoilt["incomplete"] + spoilt["dropped"] > 5


def test_pulling_a_camera_out_is_noticed_at_once_and_plugged_in_it_has_its_settings_again(
    lab: Webcams,
) -> None:
    told = lab.told("life")
    unplugged, away = told["unplugged"], told["while_away"]
    assert isinstance(unplugged, dict)
    assert isinstance(away, dict)
    assert unplugged["kind"] == "DeviceUnavailable"
    assert "ENODEV" in unplugged["says"]
    assert float(str(told["unplugged_after_s"])) < NOTICED_S
    assert away["kind"] == "DeviceUnavailable"
    assert float(str(told["back_after_s"])) < BACK_S
    has = told["back_controls"]
    assert isinstance(has, dict)
    assert (has["1.2"], has["1.4"], has["2.4"], has["2.11"]) == (1, EXPOSED_US // 100, 10, 0)


def test_the_cells_camera_is_lost_when_it_freezes_or_is_pulled_out_and_comes_back_by_itself(
    lab: Webcams,
) -> None:
    told = lab.told("owned")
    seconds = {key: float(str(value)) for key, value in told.items() if key.endswith("_s")}
    print(f"a camera with its owner, in an emulated machine: {seconds}")
    # silent for lost_s = 2 s it counts as lost; pulled out at once
    # (the last picture may have come one period, 0.2 s, before the freeze)
    assert 1.7 <= seconds["frozen_lost_s"] < 2.0 + NOTICED_S
    assert seconds["unplug_lost_s"] < NOTICED_S
    assert str(told["frozen_says"]).startswith("DeviceUnavailable: camera.left: lost: no frame for ")
    assert str(told["unplug_says"]).startswith("DeviceUnavailable: camera.left: lost: ")
    assert seconds["none_ready_s"] < BACK_S
    assert seconds["plug_ready_s"] < BACK_S
    assert (told["none_is_new"], told["plug_is_new"], told["losses"]) == (True, True, 2)
    has = told["controls"]
    assert isinstance(has, dict)
    assert (has["1.2"], has["1.4"], has["2.4"], has["2.11"]) == (1, EXPOSED_US // 100, 10, 0)


def test_two_cameras_at_30_hz_every_picture_is_new_and_every_lost_one_is_counted(lab: Webcams) -> None:
    cameras = lab.told("rate")["cameras"]
    assert isinstance(cameras, list)
    assert len(cameras) == 2
    for has in cameras:
        print(f"two cameras at 30 Hz, in an emulated machine: {has}")
        assert has["frames"] >= 3
        assert has["unread"] == 0
        assert has["repeated"] == 0
        # the camera's own numbers, read from the pictures, tell of the same losses
        assert has["dropped_since_first"] + has["incomplete_since_first"] == has["missing"]
        assert has["stamp_after_exposure_s"] <= 0.0


def test_the_contract_of_cameras_holds_for_both_ways_of_capture(lab: Webcams) -> None:
    ran = lab.machine.run(
        *("python3", "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", CODE, "-c"),
        *(f"{CODE}/pyproject.toml", f"{CODE}/tests/contract/test_camera.py", "-k", "v4l2"),
        timeout_s=200.0,
    )
    assert ran.code == 0, ran.out[-3000:] + ran.err[-1000:]
    print(ran.out.splitlines()[-1])
    assert "skipped" not in ran.out.splitlines()[-1], ran.out
