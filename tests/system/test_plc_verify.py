"""``mikado plc verify`` as a person runs it: against PLCs of either role, good and bad, and as the PLC of a
daemon. Nothing moves.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from cell import cli
from drivers.types import ToolPose
from tests.fakes.modbuswire import QUIET, polling
from tests.fakes.ports import free_port
from tests.fakes.simcell import SimCell
from tests.system.handplc import HandPlc
from tests.system.processes import ROOT, Line, daemon, until, write_config


def verify(*arguments: str, timeout_s: float = 60.0) -> tuple[int, str]:
    """Exit code and transcript."""
    done = subprocess.run(
        [sys.executable, "-m", "cell", "plc", "verify", *arguments],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
        timeout=timeout_s,
    )
    assert done.stderr == "" or "plc_server" in done.stderr or done.returncode == 2, done.stderr
    return done.returncode, done.stdout + done.stderr


@contextmanager
def simulated(*arguments: str) -> Iterator[int]:
    """The simulated PLC; its port where it listens."""
    command = [sys.executable, "-m", "drivers.sim.plc", "--orders", "20", *arguments]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as plc:
        try:
            assert plc.stdout is not None
            yield int(json.loads(plc.stdout.readline())["port"])
        finally:
            plc.terminate()
            plc.communicate(timeout=10.0)


def cell_file(folder: Path, plc: Line) -> Path:
    """A configuration of which only the section ``plc`` matters here."""
    port = plc["port"]
    assert isinstance(port, int)
    return write_config(folder, 1, port, plc=plc)


def served(port: int, **more: str) -> Line:
    return {"driver": "modbus_server", "bind": "127.0.0.1", "port": port, "peers": ["127.0.0.1"], **more}


WALK = (
    "connection",
    "map version",
    "the PLC's heartbeat",
    "order 1: accepted",
    "order 1: result",
    "order 2: its number",
    "a refused order",
    "restart in an order",
    "the same number again",
    "the cell's heartbeat",
    "enable again",
)


def test_a_good_plc_that_is_the_server_passes() -> None:
    with simulated("--port", "0") as port:
        code, said = verify("--host", "127.0.0.1", "--port", str(port), "--orders", "2", "--wait-s", "10")
    assert code == 0, said
    assert "FAIL" not in said
    assert [step for step in WALK if f"pass {step}" not in said] == []
    assert "result valid to acknowledged" in said


def test_a_good_plc_that_polls_passes(tmp_path: Path) -> None:
    port = free_port()
    with simulated("--connect", f"127.0.0.1:{port}"):
        config = cell_file(tmp_path, served(port))
        code, said = verify(str(config), "--orders", "2", "--wait-s", "10")
    assert code == 0, said
    assert "FAIL" not in said
    assert [step for step in WALK if f"pass {step}" not in said] == []


def test_a_plc_that_is_not_there_is_said_with_what_to_do() -> None:
    code, said = verify("--host", "127.0.0.1", "--port", str(free_port()), "--wait-s", "0.5")
    assert code == 1
    assert "FAIL connection" in said
    assert "no connection to 127.0.0.1" in said
    assert "check address, port, cable" in said


def test_swapped_bytes_are_told_from_a_wrong_version(tmp_path: Path) -> None:
    port = free_port()
    config = cell_file(tmp_path, served(port))
    for version, complaint in ((256, "the two bytes of every word are swapped"), (2, "writes 1 into word 0")):
        with polling(port, command=[version, *QUIET[1:]]):
            code, said = verify(str(config), "--wait-s", "3")
        assert code == 1
        assert "FAIL map version" in said
        assert complaint in said


def test_a_plc_whose_heartbeat_stands_and_whose_target_is_nowhere_fails(plc: HandPlc) -> None:
    nowhere = ToolPose(x=-1.0, y=0.0, z=503.0, rx=0.0, ry=0.0, rz=0.0)
    with plc.program.lock:
        plc.program.command = replace(plc.program.command, pose=nowhere)
    with plc.standing():
        code, said = verify("--host", "127.0.0.1", "--port", str(plc.port), "--wait-s", "0.5")
    assert code == 1
    assert "FAIL the PLC's heartbeat" in said
    assert "FAIL word order of the target" in said
    assert "use the other plc.word_order" in said
    assert "FAIL enable" in said


def test_bits_switched_by_hand_are_waited_for(plc: HandPlc) -> None:
    with subprocess.Popen(
        [
            *(
                sys.executable,
                "-u",
                "-m",
                "cell",
                "plc",
                "verify",
                "--bits",
                "--orders",
                "1",
                "--wait-s",
                "4",
            ),
            *("--host", "127.0.0.1", "--port", str(plc.port)),
        ],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    ) as running:
        assert running.stdout is not None
        said = ""
        until(lambda: len(plc.program.writes) > 3, 20.0, "it polls")
        plc.change(enable=True)
        for line in running.stdout:
            said += line
            if "pass enable" in line and plc.sequence == 0:
                plc.result(plc.order())
            for name, field in (("hold", "hold"), ("abort", "abort"), ("reset_fault", "reset_fault")):
                if f"now switch {name} " in line:
                    for level in (True, False):
                        plc.change(**{field: level})
                        read = len(plc.program.writes) + 3
                        until(
                            lambda read=read: len(plc.program.writes) > read or running.poll() is not None,  # type: ignore[misc]
                            5.0,
                            f"{name} read",
                        )
        running.wait(20.0)
    assert running.returncode == 0, said
    assert all(f"pass bit {name}" in said for name in ("hold", "abort", "reset_fault"))


def test_the_plc_s_side_against_a_daemon_passes_and_moves_nothing(tmp_path: Path, cell: SimCell) -> None:
    port, motions = free_port(), cell.count("motions")
    config = write_config(tmp_path, cell.port, port, plc=served(port))
    with daemon(config) as running:
        running.started()
        code, said = verify(str(config), "--as-plc", "--orders", "3", "--wait-s", "15")
        assert code == 0, said
        assert "FAIL" not in said
        for step in ("test registers", "mirrored status", "a wrong check word", "hold", "abort, reset"):
            assert f"pass {step}" in said
        assert "pass a heartbeat that stands" in said
        assert cell.count("motions") == motions

        # a file that says another word order than the daemon runs with
        other = tmp_path / "other.yaml"
        data = yaml.safe_load(config.read_text(encoding="utf-8"))
        data["plc"]["word_order"] = "little"
        other.write_text(yaml.safe_dump(data), encoding="utf-8")
        code, said = verify(str(other), "--as-plc", "--wait-s", "2")
        assert code == 1
        assert "FAIL test registers" in said
        assert "word order big" in said
    code, said = verify(str(config), "--as-plc", "--wait-s", "2")
    assert code == 1
    assert "FAIL connection" in said


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ((), "needs a CONFIG, or --host"),
        (("--host", "192.0.2.1", "--port", "70000"), "less than or equal to 65535"),
        (("--host", "192.0.2.1", "--orders", "0"), "--orders is at least 1"),
        (("--host", "cell.example", "--as-plc"), "not an address in numbers"),
        (("configs/demo/cell.yaml", "--host", "192.0.2.1"), "not both"),
        (("configs/demo/cell.yaml", "--as-plc"), "needs plc.driver: modbus_server"),
    ],
)
def test_a_command_line_that_means_nothing_is_refused(
    arguments: tuple[str, ...], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["plc", "verify", *arguments]) == 2
    assert complaint in capsys.readouterr().err
