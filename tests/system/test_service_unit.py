"""The unit file: what systemd says of it, and whether it agrees with the daemon."""

from __future__ import annotations

import configparser
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from cell import cli, daemon
from drivers.settings import ModbusServerPlcSettings
from tests.system.processes import ROOT

UNIT = ROOT / "systemd" / "mikado.service"


@pytest.fixture(scope="module")
def unit() -> configparser.ConfigParser:
    parsed = configparser.ConfigParser(interpolation=None, strict=True)
    parsed.optionxform = str  # type: ignore[assignment,method-assign]  # keys of systemd are case-sensitive
    parsed.read_string(UNIT.read_text(encoding="utf-8"))
    return parsed


def test_systemd_finds_nothing_wrong(tmp_path: Path) -> None:
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not on this machine: THE UNIT FILE HAS NOT BEEN VERIFIED")
    copy = shutil.copy(UNIT, tmp_path)
    checked = subprocess.run(
        [analyze, "verify", "--man=no", str(copy)], check=False, capture_output=True, text=True, timeout=60.0
    )
    assert (checked.returncode, checked.stdout + checked.stderr) == (0, "")


def test_a_unit_with_a_spelling_mistake_would_be_found(tmp_path: Path) -> None:
    """The test above can fail."""
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not on this machine")
    wrong = tmp_path / UNIT.name
    wrong.write_text(UNIT.read_text().replace("WatchdogSec=", "WatchDogSeconds="))
    checked = subprocess.run(
        [analyze, "verify", "--man=no", str(wrong)], check=False, capture_output=True, text=True, timeout=60.0
    )
    assert "WatchDogSeconds" in checked.stderr


def test_the_manager_waits_for_the_daemons_word(unit: configparser.ConfigParser) -> None:
    service = unit["Service"]
    assert service["Type"] == "notify"
    assert service["NotifyAccess"] == "main"  # the main thread of the main process is who speaks


def test_it_restarts_after_a_failure_and_not_for_a_wrong_configuration(
    unit: configparser.ConfigParser,
) -> None:
    service = unit["Service"]
    assert service["Restart"] == "on-failure"
    never = {int(code) for code in service["RestartPreventExitStatus"].split()}
    assert cli.EXIT_CONFIG in never
    assert cli.EXIT_FAILED not in never
    # a daemon that fails again and again is not restarted for ever
    assert int(unit["Unit"]["StartLimitBurst"]) * float(service["RestartSec"]) < float(
        unit["Unit"]["StartLimitIntervalSec"]
    )


def test_its_times_fit_the_daemons_own(unit: configparser.ConfigParser) -> None:
    service = unit["Service"]
    ending_s = daemon._END_CELL_S + 2 * daemon._END_OTHERS_S
    assert ending_s <= 5.0
    assert float(service["TimeoutStopSec"]) > 5.0  # what is promised, and a little more
    watchdog_s = float(service["WatchdogSec"])
    assert watchdog_s / 4 >= daemon._TICK_S  # a few beats may come late
    # a worker that hangs is noticed, and only then the manager's time begins to run
    assert max(daemon._CELL_LIMIT_S, daemon._PLC_LIMIT_S) < watchdog_s


def test_it_runs_the_command_that_exists_and_not_what_lies_in_the_working_folder(
    unit: configparser.ConfigParser,
) -> None:
    command = unit["Service"]["ExecStart"].split()
    at = command.index("-m")
    assert command[at + 1] == "cell"
    assert "-P" in command[:at]
    parsed = cli.parser().parse_args(command[at + 2 :])
    assert (parsed.command, parsed.json, parsed.config.is_absolute()) == ("run", True, True)


def test_nothing_it_starts_may_write_where_it_must_not(unit: configparser.ConfigParser) -> None:
    service = unit["Service"]
    assert service["User"] not in ("", "root")
    assert service["StateDirectory"] == "mikado"  # the journal and the calibration
    assert f"/var/cache/{service['CacheDirectory']}" in service["Environment"]  # compiled code


def test_it_may_listen_on_the_port_of_modbus_and_has_no_other_right(unit: configparser.ConfigParser) -> None:
    service = unit["Service"]
    assert service["AmbientCapabilities"] == service["CapabilityBoundingSet"] == "CAP_NET_BIND_SERVICE"
    assert ModbusServerPlcSettings.model_fields["port"].default == 502


def test_an_unprivileged_user_with_that_right_listens_on_502_and_without_it_is_told_why(
    tmp_path: Path,
) -> None:
    """What the unit gives, given by `setpriv` here; in a network namespace of its own, so 502 is free."""
    setpriv, unshare = shutil.which("setpriv"), shutil.which("unshare")
    if os.getuid() != 0 or setpriv is None or unshare is None:
        pytest.skip("needs root, setpriv and unshare: LISTENING ON PORT 502 HAS NOT BEEN TRIED")
    script = (
        "from drivers.errors import DriverError\n"
        "from drivers.plc.server import ModbusServerPlc\n"
        "from drivers.settings import ModbusServerPlcSettings\n"
        "from drivers.timing import MonotonicClock\n"
        "s = ModbusServerPlcSettings(driver='modbus_server', bind='0.0.0.0', peers=('127.0.0.1',))\n"
        "plc = ModbusServerPlc('plc', s, MonotonicClock())\n"
        "try:\n"
        "    plc.open()\n"
        "    print('listens on', s.port)\n"
        "except DriverError as error:\n"
        "    print(error)\n"
        "plc.close()\n"
    )

    def tried(*rights: str) -> str:
        done = subprocess.run(
            [
                *(
                    unshare,
                    "--net",
                    "sh",
                    "-c",
                    'echo 1024 >/proc/sys/net/ipv4/ip_unprivileged_port_start; exec "$@"',
                ),
                *("-", setpriv, "--reuid=65534", "--regid=65534", "--clear-groups", *rights),
                *(sys.executable, "-c", script),
            ],
            cwd=ROOT,
            check=False,
            capture_output=True,
            text=True,
            timeout=30.0,
        )
        if any(why in done.stderr for why in ("unshare", "Operation not permitted", "failed to execute")):
            pytest.skip(f"PORT 502 HAS NOT BEEN TRIED, this machine does not allow it: {done.stderr.strip()}")
        return done.stdout + done.stderr

    right = "net_bind_service"
    assert "listens on 502" in tried(
        f"--inh-caps=-all,+{right}", f"--ambient-caps=-all,+{right}", f"--bounding-set=-all,+{right}"
    )
    told = tried("--inh-caps=-all", "--ambient-caps=-all", "--bounding-set=-all")
    assert "cannot listen on 0.0.0.0:502: not permitted" in told
    assert "CAP_NET_BIND_SERVICE" in told
