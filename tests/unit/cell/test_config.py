"""The configuration refuses what cannot be meant, and says so with file, line and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from cell import config
from cell.errors import ConfigError
from drivers.camera_settings import ReplayCameraSettings
from tests.fakes.station import DATA

TEXT = (DATA / "cell.yaml").read_text()
REPOSITORY = Path(__file__).parents[3]


def refused(tmp_path: Path, old: str, new: str) -> str:
    assert TEXT.count(old) == 1, f"the good file has {TEXT.count(old)} times {old!r}"
    path = tmp_path / "cell.yaml"
    path.write_text(TEXT.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        config.load(path)
    message = str(caught.value)
    assert message.startswith(f"{path}:")
    assert "\n" not in message
    return message


def test_the_good_file_loads_with_its_paths_made_absolute() -> None:
    loaded = config.load(DATA / "cell.yaml")
    assert loaded.files.calibration == DATA / "calibration.json"
    assert loaded.files.journal == DATA / "journal.sqlite"
    assert loaded.files.overlays is None
    left = loaded.cameras.left
    assert isinstance(left, ReplayCameraSettings)
    assert left.folder.resolve() == DATA
    assert loaded.part(2) == loaded.parts[1]
    assert loaded.part(3) is None


def test_the_shipped_configurations_load() -> None:
    shipped = sorted(REPOSITORY.glob("configs/*/cell.yaml"))
    assert shipped
    for path in shipped:
        assert config.load(path).version == 1
    for path in sorted(REPOSITORY.glob("configs/parts/*.yaml")):
        assert config.load_part(path).model().length_m > 0


def test_two_tries_with_one_file_give_the_same_settings() -> None:
    assert config.load(DATA / "cell.yaml") == config.load(DATA / "cell.yaml")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("version: 1", "version: 2", "2: version: Input should be 1, found 2"),
        ("port: 5020", "port: 70000", "plc.port: Input should be less than or equal to 65535, found 70000"),
        ("port: 5020", "port: 0", "plc.port: Input should be greater than or equal to 1, found 0"),
        ("port: 5020", "port: modbus", "plc.port: Input should be a valid integer"),
        ("plc: {driver: modbus", "plc: {driver: profinet", "plc: Input tag 'profinet'"),
        (
            "plc: {driver: modbus, host: 127.0.0.1",
            "plc: {driver: modbus_server, bind: plc, peers: [127.0.0.1]",
            "plc.bind: 'plc' is not an address in numbers",
        ),
        ('replay, folder: ., pattern: "left', 'laser, folder: ., pattern: "left', "Input tag 'laser'"),
        ("max_skew_s: 0.04", "max_skew_s: 0", "cameras.max_skew_s: Input should be greater than 0"),
        ("mount: fixed", "mount: ceiling", "cameras.mount: Input should be 'fixed' or 'tool'"),
        ("opening_m: 0.020", "opening_m: 0.003", "diameter_m 0.004 does not fit jaws.opening_m 0.003"),
        ("box_min_m: [-0.16,", "box_min_m: [0.20,", "box is empty along x: min 0.2 is not below max 0.16"),
        ("box_max_m: [0.16,", "box_max_m: [160.0,", "out of any arm's reach; metres are expected"),
        ("travel_z_m: 0.150", "travel_z_m: 0.05", "travel_z_m 0.05 lies inside the box (top 0.1)"),
        ("floor_z_m: 0.020", "floor_z_m: .nan", "workspace.floor_z_m: Input should be a finite number"),
        ("watch_q_rad: [0.0,", "watch_q_rad: [", "workspace.watch_q_rad.5: is missing"),
        ("floor_clearance_m: 0.0003", "floor_clearance_m: 0.002", "fingers above the middle of a part"),
        ("allow_mixed: true", "allow_mixed: false", "cameras.left, cameras.right not simulated"),
        ("  - {code: 2,", "  - {code: 1,", "parts: code 1 is given twice"),
        ("  - {code: 2,", "  - {code: 65536,", "parts.1.code: Input should be less than or equal to 65535"),
        ("length_m: 0.120", "length_m: 120", "length_m 120.0 is over 2 m: lengths are in metres"),
        ("0.120, length_tolerance_m: 0.004", "0.120, length_tolerance_m: 0.06", "is over half of length_m"),
        ("files: {", "tuning: {band: [200, 100]}\nfiles: {", "band is empty: min 200 is not below max 100"),
        (
            "files: {",
            "tuning: {band: [0, 256]}\nfiles: {",
            "tuning.band.1: Input should be less than or equal",
        ),
        ("files: {", "tuning: {min_score: 2}\nfiles: {", "tuning.min_score: Input should be less than"),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert said in refused(tmp_path, old, new)


def test_pictures_of_two_sizes_are_refused(tmp_path: Path) -> None:
    said = refused(tmp_path, 'pattern: "right*.png", width_px: 480', 'pattern: "right*.png", width_px: 640')
    assert "cameras: left is 480x360 px, right 640x360: must be the same" in said


def test_no_part_is_no_cell(tmp_path: Path) -> None:
    kept = [line for line in TEXT.splitlines() if not line.startswith(("parts:", "  - {code"))]
    path = tmp_path / "cell.yaml"
    path.write_text("\n".join([*kept, "parts: []", ""]))
    with pytest.raises(ConfigError, match=r"parts: .* at least 1 item"):
        config.load(path)


def test_gates_reach_the_detector_as_they_stand_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(
        TEXT + "tuning: {method: published, band: [100, 255], depth_m: [0.2, 0.4], length_2d: true}\n"
    )
    tuning = config.load(path).tuning.tuning()
    assert (tuning.method, tuning.band, tuning.depth_m, tuning.length_2d) == (
        "published",
        (100, 255),
        (0.2, 0.4),
        True,
    )


def test_a_product_file_is_one_entry_of_parts() -> None:
    part = config.load_part(DATA / "part.yaml").model()
    assert (part.code, part.name, part.length_m) == (1, "stick-80", 0.080)
    assert (part.length_tolerance_m, part.diameter_m) == (0.004, 0.004)


def test_a_product_file_with_a_misspelt_key_says_which(tmp_path: Path) -> None:
    path = tmp_path / "part.yaml"
    path.write_text((DATA / "part.yaml").read_text().replace("length_m", "lenght_m", 1))
    with pytest.raises(ConfigError, match=r"part\.yaml:.*lenght_m: unknown key"):
        config.load_part(path)
