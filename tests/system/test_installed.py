"""The installed form: a wheel in an environment of its own, run from an empty folder; and what start-up says
when the three packages are not of one installation."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from tests.system.processes import ROOT

pytest.importorskip("hatchling", reason="building the wheel needs the build backend of the dev requirements")


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh environment with our wheel; what the wheel needs is lent by the environment of the tests."""
    home = tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    wheel = ["wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir"]
    subprocess.run([*pip, *wheel, str(home), str(ROOT)], check=True, cwd=home, timeout=120.0)
    (built,) = home.glob("mikado_cell-*.whl")
    environment = home / "env"
    subprocess.run(
        [sys.executable, "-m", "venv", "--without-pip", str(environment)], check=True, timeout=60.0
    )
    python = environment / "bin" / "python"
    subprocess.run(
        [*pip, "--python", str(python), "install", "--quiet", "--no-deps", "--no-index", str(built)],
        check=True,
        cwd=home,
        timeout=120.0,
    )
    (site,) = environment.glob("lib/python*/site-packages")
    # a plain path: the editable install of the checkout, which lies there as well, does not come along
    (site / "lent.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return environment


def _run(
    command: list[str], folder: Path, before: Path | None = None, within_s: float = 60.0
) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "NOTIFY_SOCKET")}
    if before is not None:
        environment["PYTHONPATH"] = str(before)
    return subprocess.run(
        command, check=False, cwd=folder, env=environment, capture_output=True, text=True, timeout=within_s
    )


def test_the_wheel_holds_the_three_packages_and_the_licence_and_nothing_else(installed: Path) -> None:
    (site,) = installed.glob("lib/python*/site-packages")
    (info,) = site.glob("mikado_cell-*.dist-info")
    names = [line.split(",")[0] for line in (info / "RECORD").read_text().splitlines()]
    tops = {name.split("/")[0] for name in names if ".dist-info" not in name and not name.startswith("..")}
    assert tops == {"cell", "drivers", "vision"}
    assert any(name.endswith("licenses/LICENSE") for name in names)


def test_the_command_runs_from_an_empty_folder(installed: Path, tmp_path: Path) -> None:
    mikado = str(installed / "bin" / "mikado")
    version = _run([mikado, "--version"], tmp_path)
    assert (version.returncode, version.stderr) == (0, "")
    assert version.stdout.startswith("mikado 0.")

    config = ROOT / "configs" / "demo" / "cell.yaml"
    for command in ([mikado], [str(installed / "bin" / "python"), "-P", "-m", "cell"]):
        checked = _run([*command, "check", str(config)], tmp_path)
        assert (checked.returncode, checked.stderr) == (0, "")
        assert "good" in checked.stdout

    demo = _run([mikado, "demo"], tmp_path)
    assert demo.returncode == 2
    assert demo.stderr.splitlines() == [
        "mikado: configs/demo/cell.yaml: not found; run the demo in the checkout, or give --config"
    ]
    assert list(tmp_path.iterdir()) == []


def test_the_installed_daemon_empties_a_tray(installed: Path, tmp_path: Path) -> None:
    """Its own code throughout: the three processes are started from the installed packages."""
    config = ROOT / "configs" / "demo" / "cell.yaml"
    more = ("--config", str(config), "--sticks", "1", "--speed", "8", "--out", "out", "--deadline-s", "90")
    done = _run(
        [str(installed / "bin" / "mikado"), "demo", *more], tmp_path, within_s=600.0
    )  # compiles its own detector
    assert done.returncode == 0, done.stdout + done.stderr


def _foreign(folder: Path) -> str:
    """Somebody else's package of one of our names."""
    (folder / "vision").mkdir(parents=True)
    (folder / "vision" / "__init__.py").write_text('"""Another vision."""\n')
    return "vision"


def _broken(folder: Path) -> str:
    (folder / "vision").mkdir(parents=True)
    (folder / "vision" / "__init__.py").write_text("import something_that_is_not_there\n")
    return "vision"


def _second_installation(folder: Path) -> str:
    """Our own package, of another installation."""
    shutil.copytree(ROOT / "drivers", folder / "drivers", ignore=shutil.ignore_patterns("__pycache__"))
    return "drivers"


@pytest.mark.parametrize("shadow", [_foreign, _broken, _second_installation])
def test_packages_of_two_installations_do_not_start(installed: Path, tmp_path: Path, shadow: object) -> None:
    assert callable(shadow)
    name = shadow(tmp_path / "first")
    config = str(ROOT / "configs" / "demo" / "cell.yaml")
    for command in (["check", config], ["run", config]):
        ended = _run([str(installed / "bin" / "mikado"), *command], tmp_path, before=tmp_path / "first")
        assert ended.returncode == 1
        assert ended.stdout == ""
        (line,) = ended.stderr.splitlines()
        assert line.startswith("mikado: ")
        assert name in line
        assert "install mikado-cell anew" in line
