"""The daemon with Modbus peers nobody here wrote, a whole pick each way: a PLC in C on libmodbus in both
roles, and the command-line client mbpoll. `tests/lab/setup.sh` installs them.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers.types import PlcCommand
from tests.fakes.ports import free_port
from tests.fakes.simcell import SimCell, sim_cell
from tests.system.processes import ROOT, SPEED, Daemon, Line, daemon, orders, write_config

SOURCES = Path(__file__).parent / "modbus"
LOUD = "THE PEER IS MISSING AND INTEROPERATION IS NOT TESTED; run tests/lab/setup.sh as root"


@pytest.fixture(scope="module")
def cell() -> Iterator[SimCell]:
    with sim_cell("--speed", SPEED, "--seed", "7", "--sticks", "8") as running:
        yield running


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The two C programs."""
    compiler = shutil.which("gcc")
    if compiler is None or not Path("/usr/include/modbus/modbus.h").is_file():
        pytest.skip(f"gcc or libmodbus: {LOUD}")
    folder = tmp_path_factory.mktemp("modbus")
    for name in ("client", "server"):
        command = [
            *(compiler, "-Wall", "-Wextra", "-Werror", "-O1", "-o", str(folder / name)),
            *(str(SOURCES / f"{name}.c"), "-I/usr/include/modbus", "-lmodbus"),
        ]
        subprocess.run(command, check=True, timeout=60.0)
    return folder


def served(port: int, word_order: str = "big") -> Line:
    return {
        "driver": "modbus_server",
        "bind": "127.0.0.1",
        "port": port,
        "peers": ["127.0.0.1"],
        "word_order": word_order,
    }


def picked_and_done(running: Daemon, folder: Path, cell: SimCell, boxed: int, picks: int) -> None:
    """What the daemon, its journal and the cell's own count say."""
    assert cell.count("in_box") == boxed + picks
    rows = orders(folder)
    assert [(row.finished, row.code) for row in rows] == [(True, 1)] * picks
    assert not running.events("fault_raised")
    assert running.terminate()[0] == 0


def test_a_plc_on_libmodbus_that_polls_the_cell_has_parts_picked(
    tmp_path: Path, cell: SimCell, built: Path
) -> None:
    port, boxed = free_port(), cell.count("in_box")
    with daemon(write_config(tmp_path, cell.port, port, plc=served(port))) as running:
        running.started()
        done = subprocess.run(
            [str(built / "client"), "127.0.0.1", str(port), "2"],
            check=False,
            capture_output=True,
            text=True,
            timeout=90.0,
        )
        print(done.stdout)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "WRONG" not in done.stdout
        assert done.stdout.count("ok: ") >= 20
        results = re.findall(r"result (\d+) code (\d+) quantity (\d+) x (-?\d+) y (-?\d+)", done.stdout)
        assert [row[:3] for row in results] == [("1", "1", "1"), ("2", "1", "1")]
        for *_, x, y in results:  # micrometres, inside the tray
            assert -130_000 < int(x) < 130_000
            assert -550_000 < int(y) < -350_000
        picked_and_done(running, tmp_path, cell, boxed, 2)


def test_a_plc_on_libmodbus_that_the_cell_polls_has_parts_picked(
    tmp_path: Path, cell: SimCell, built: Path
) -> None:
    port, boxed = free_port(), cell.count("in_box")
    section: Line = {"driver": "modbus", "host": "127.0.0.1", "port": port, "test_base": 200}
    with (
        subprocess.Popen([str(built / "server"), str(port), "2"], stdout=subprocess.PIPE, text=True) as plc,
        daemon(write_config(tmp_path, cell.port, port, plc=section)) as running,
    ):
        try:
            said, _ = plc.communicate(timeout=90.0)
        finally:
            plc.kill()
        print(said)
        assert plc.returncode == 0, said
        assert "ok: test registers" in said
        assert re.findall(r"result (\d+) code (\d+) quantity (\d+)", said) == [
            ("1", "1", "1"),
            ("2", "1", "1"),
        ]
        picked_and_done(running, tmp_path, cell, boxed, 2)


class Mbpoll:
    """Each request is a process of its own with a connection of its own."""

    def __init__(self, program: str, port: int) -> None:
        self._command = [program, "-m", "tcp", "-p", str(port), "-0", "-1", "-q"]

    def _run(self, *arguments: str) -> str:
        done = subprocess.run(
            [*self._command, *arguments], check=False, capture_output=True, text=True, timeout=10.0
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def read(self, table: str, first: int, count: int, *more: str) -> list[int]:
        said = self._run("-t", table, "-r", str(first), "-c", str(count), *more, "127.0.0.1")
        return [int(value) for value in re.findall(r"^\[\d+\]:\s+(-?\d+)", said, re.M)]

    def write(self, table: str, first: int, values: list[int]) -> None:
        self._run("-t", table, "-r", str(first), "127.0.0.1", *[str(value) for value in values])


class SlowPlc:
    """A program over `Mbpoll`. On a busy machine its processes start so slowly that the cell may lose it;
    then it does what a PLC does: enable low and high, and another order."""

    def __init__(self, plc: Mbpoll) -> None:
        self._plc = plc
        self.command = [1, *([0] * 23)]

    def poll(self) -> list[int]:
        self.command[1] = (self.command[1] + 1) & 0xFFFF
        self._plc.write("4", 0, self.command)
        return [value & 0xFFFF for value in self._plc.read("3", 0, 40)]

    def wait(self, what: str, bit: int, on: bool) -> list[int]:
        """Until a bit of the status word is so."""
        return self._until(what, lambda status: bool(status[2] & bit) is on)

    def _until(self, what: str, so: Callable[[list[int]], bool]) -> list[int]:
        ends_at = time.monotonic() + 40.0
        while not so(status := self.poll()):
            assert time.monotonic() < ends_at, f"not within 40 s: {what}; the cell shows {status}"
        return status

    def pick(self) -> list[int]:
        """One whole order; the status with its result."""
        self.command[4:6] = [int(PlcCommand.PICK_AND_PLACE), 1]
        self.command[8] = 3
        for _ in range(5):
            self.command[2] = 0
            self.wait("the cell hears the PLC", 1 << 12, True)
            self.poll()
            self.command[2] = 1
            ready = self._until("ready, or lost", lambda s: bool(s[2] & 1) or not s[2] & 1 << 12)
            if not ready[2] & 1:
                continue
            self.command[3] += 1
            number = self.command[3]
            status = self._until(
                "an answer",
                lambda s, n=number: bool(s[2] & 1 << 3 and s[6] == n) or (s[4] == n and s[5] != 0),  # type: ignore[misc]
            )
            if not status[2] & 1 << 3:
                continue  # refused: the link was lost after ready
            self.command[23] = number
            self.wait("the result dropped", 1 << 3, False)
            if status[7] != 41:
                return status
        raise AssertionError("the machine is too busy: the link was lost five times")


@pytest.fixture
def mbpoll() -> Callable[[int], Mbpoll]:
    program = shutil.which("mbpoll")
    if program is None:
        pytest.skip(f"mbpoll: {LOUD}")
    return lambda port: Mbpoll(program, port)


@pytest.mark.parametrize("order", ["big", "little"])
def test_mbpoll_reads_and_writes_every_table_and_orders_a_pick(
    tmp_path: Path, cell: SimCell, mbpoll: Callable[[int], Mbpoll], order: str
) -> None:
    port, boxed = free_port(), cell.count("in_box")
    words_first = ("-B",) if order == "big" else ()
    with daemon(write_config(tmp_path, cell.port, port, plc=served(port, order))) as running:
        running.started()
        plc = mbpoll(port)
        # its own idea of word order, and the test registers that tell which one is right
        assert plc.read("3:int", 202, 2, *words_first) == [305419896, -123456]
        assert plc.read("4:int", 202, 1, *(() if order == "big" else ("-B",))) == [1450709556]
        orderer = SlowPlc(plc)
        orderer.wait("the cell hears the PLC", 1 << 12, True)
        plc.write("0", 0, [1])  # the enable bit as a coil
        assert plc.read("0", 0, 2) == [1, 0]
        assert plc.read("4", 100, 2)[0] == 1  # the mirror
        assert len(plc.read("1", 0, 16)) == 16
        status = orderer.pick()
        assert (status[6], status[7], status[9]) == (orderer.command[3], 1, 1)
        x, y = plc.read("3:int", 12, 2, *words_first)
        assert -130_000 < x < 130_000
        assert -550_000 < y < -350_000
        assert cell.count("in_box") == boxed + 1
        codes = [row.code for row in orders(tmp_path)]
        assert codes[-1] == 1
        assert set(codes[:-1]) <= {41}
        assert running.terminate()[0] == 0


def test_the_set_up_names_every_peer_these_tests_look_for() -> None:
    script = (ROOT / "tests" / "lab" / "setup.sh").read_text(encoding="utf-8")
    assert {"mbpoll", "libmodbus-dev", "gcc"} <= set(script.split())
    assert sys.platform == "linux"
