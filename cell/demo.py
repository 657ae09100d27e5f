"""The demo: daemon, simulated cell and simulated PLC as three processes; the PLC empties the tray.

Nothing is simulated in here. The daemon is the one of `mikado run`; the PLC orders over Modbus TCP. The
verdict does not rest on the daemon's word: the simulated cell counts what lies in its box, the PLC checks
every handshake.
"""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import IO, Final, TypeAlias

import yaml
from rich.console import Console

from cell.errors import ConfigError, UsageError
from drivers.timing import MonotonicClock
from vision.default import warm_up

Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | bool | None"
Line: TypeAlias = dict[str, "Json"]

_START_S: Final = 30.0
_END_S: Final = 6.0
_MADE: Final = ("cell.yaml", "demo.sqlite", "demo.sqlite-wal", "demo.sqlite-shm", "plc.json", "summary.json")
_LOGS: Final = ("daemon.log", "plc.log", "sim.log")


@dataclass(slots=True)
class _Child:
    """A process whose standard output is JSON lines, kept whole in a log file."""

    name: str
    process: subprocess.Popen[bytes]
    log: IO[bytes]
    rest: bytes = b""
    over: bool = False

    def read(self) -> list[Line]:
        """The lines that have come; what is not JSON is only kept in the log."""
        assert self.process.stdout is not None
        data = os.read(self.process.stdout.fileno(), 65536)
        if not data:
            self.over = True
        self.log.write(data)
        self.log.flush()
        *whole, self.rest = (self.rest + data).split(b"\n")
        lines: list[Line] = []
        for text in whole:
            try:
                line = json.loads(text)
            except ValueError:
                continue
            if isinstance(line, dict):
                lines.append(line)
        return lines

    def end(self, timeout_s: float) -> int | None:
        """SIGTERM and wait; None when it had to be killed."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            return None
        return self.process.returncode


@dataclass(slots=True)
class _Story:
    """What the three processes told, for the terminal and the summary."""

    console: Console
    sticks: int
    results: list[Line] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)
    closed: int = 0
    picked: int = 0

    def daemon(self, line: Line) -> None:
        match line.get("event"):
            case "look_finished":
                self.console.print(
                    f"  look: {line.get('offered')} offered of {line.get('seen')} seen, "
                    f"detector {_ms(line.get('find_s'))}"
                )
            case "grip_closed":
                self.console.print(f"  grip: {line.get('grip')}")
            case "pick_finished":
                self._finished(line)
            case "fault_raised":
                self.console.print(
                    f"[red]fault {line.get('code')} {line.get('name')}: {line.get('detail')}[/red]"
                )
            case "worker_failed" | "worker_stalled":
                self.console.print(f"[red]{line.get('event')}: {line.get('worker')}[/red]")

    def _finished(self, line: Line) -> None:
        self.results.append(line)
        if line.get("outcome") == "PICKED":
            self.picked += 1
        durations = line.get("durations_s")
        stages = (
            "  ".join(f"{name} {_ms(s)}" for name, s in durations.items() if "." not in name)
            if isinstance(durations, dict)
            else ""
        )
        colour = "green" if line.get("outcome") == "PICKED" else "yellow"
        self.console.print(
            f"  [{colour}]{line.get('outcome')}[/{colour}] code {line.get('code')} after "
            f"{_s(line.get('took_s'))}   {stages}"
        )
        self.console.print(f"  {self.picked} of {self.sticks} picked")

    def plc(self, line: Line) -> None:
        match line.get("event"):
            case "ordered":
                self.console.print(f"[bold]PLC orders pick, sequence {line.get('seq')}[/bold]")
            case "closed":
                self.closed += 1
            case "violation":
                self.violations.append(str(line.get("text", line)))
                self.console.print(f"[red]handshake: {line.get('text', line)}[/red]")


def _ms(seconds: Json) -> str:
    return f"{1000 * seconds:.0f} ms" if isinstance(seconds, int | float) else "?"


def _s(seconds: Json) -> str:
    return f"{seconds:.2f} s" if isinstance(seconds, int | float) else "?"


def demo(config: Path, out: Path, *, sticks: int, seed: int, speed: float, deadline_s: float) -> int:
    """Run the demo into ``out``; 0 only if every stick was picked and every handshake closed.

    Raises
    ------
    UsageError, ConfigError
        Nothing to run with, nowhere to write, or a process that does not start.
    """
    if sticks < 1:
        raise UsageError(f"--sticks {sticks}: at least one")
    world = config.parent / "world.yaml"
    for needed in (config, world):
        if not needed.is_file():
            raise UsageError(f"{needed}: not found; run the demo in the checkout, or give --config")
    _clear(out)
    console = Console(highlight=False, soft_wrap=True)
    console.print("Compiling the detector: a minute or two on a new machine, a second later on.")
    # here and not while the PLC waits for the cell to be ready
    warm_up()
    children: list[_Child] = []
    asked = _asked_to_end()
    try:
        return _play(config, world, out, console, children, asked, sticks, seed, speed, deadline_s)
    finally:
        for child in reversed(children):
            child.end(_END_S)
            child.log.close()


def _asked_to_end() -> threading.Event:
    """Set by SIGTERM or Ctrl-C: the children must not outlive the demo."""
    asked = threading.Event()

    def ask(_number: int, _frame: FrameType | None) -> None:
        asked.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, ask)
    return asked


def _play(
    config: Path,
    world: Path,
    out: Path,
    console: Console,
    children: list[_Child],
    asked: threading.Event,
    sticks: int,
    seed: int,
    speed: float,
    deadline_s: float,
) -> int:
    clock = MonotonicClock()
    sim = _start(
        "sim",
        out,
        children,
        [
            *("drivers.sim.cell", "--world", str(world), "--port", "0"),
            *("--speed", str(speed), "--seed", str(seed), "--sticks", str(sticks)),
        ],
    )
    sim_port = _port(sim, clock, asked)
    plc = _start(
        "plc",
        out,
        children,
        ["drivers.sim.plc", "--port", "0", "--orders", "until-empty", "--out", str(out / "plc.json")],
    )
    plc_port = _port(plc, clock, asked)
    own = _own_config(config, out, sim_port, plc_port)
    console.print(
        f"simulated cell on port {sim_port} ({sticks} sticks, seed {seed}, time x{speed:g}), "
        f"simulated PLC on port {plc_port} (Modbus TCP), daemon: mikado run {own}"
    )
    began_at = clock.now()
    daemon = _start("daemon", out, children, ["cell", "run", str(own), "--json"], merge=True)
    story = _Story(console=console, sticks=sticks)
    failed = _follow(story, daemon, plc, sim, clock, asked, began_at + deadline_s)
    if failed is not None:
        console.print(f"[red]{failed}[/red]; see {out}/*.log")
    daemon_code = daemon.end(_END_S)
    plc_code = plc.end(_END_S)
    truth = _truth(sim)
    return _verdict(story, out, failed, daemon_code, plc_code, truth, clock.now() - began_at)


def _clear(out: Path) -> None:
    """Remove what an earlier demo made, and nothing else."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name in (*_MADE, *_LOGS):
            (out / name).unlink(missing_ok=True)
        for old in (out / "overlays").glob("look-*.png"):
            old.unlink()
    except OSError as error:
        raise UsageError(f"{out}: cannot be written: {error.strerror}") from error


def _start(name: str, out: Path, children: list[_Child], module: list[str], *, merge: bool = False) -> _Child:
    log = (out / f"{name}.log").open("wb")
    process = subprocess.Popen(
        [sys.executable, "-m", *module],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT if merge else log,
    )
    child = _Child(name=name, process=process, log=log)
    children.append(child)
    return child


def _port(child: _Child, clock: MonotonicClock, asked: threading.Event) -> int:
    """The port a simulated device says it listens on."""
    until = clock.now() + _START_S
    with selectors.DefaultSelector() as selector:
        assert child.process.stdout is not None
        selector.register(child.process.stdout, selectors.EVENT_READ)
        while clock.now() < until and not child.over and not asked.is_set():
            if selector.select(0.2):
                for line in child.read():
                    port = line.get("port")
                    if line.get("event") == "listening" and isinstance(port, int):
                        return port
    if asked.is_set():
        raise UsageError("asked to end before the demo had begun")
    raise UsageError(f"the {child.name} process did not start; see {child.log.name}")


def _own_config(config: Path, out: Path, sim_port: int, plc_port: int) -> Path:
    """The demo's configuration with the ports in it, beside its output."""
    try:
        data = yaml.safe_load(config.read_text(encoding="utf-8"))
        for section in (data["cameras"]["left"], data["cameras"]["right"], data["robot"], data["gripper"]):
            section["port"] = sim_port
        data["plc"]["port"] = plc_port
        calibration = config.parent / data["files"]["calibration"]
        data["files"]["calibration"] = os.path.relpath(calibration, out)
    except (OSError, yaml.YAMLError, KeyError, TypeError) as error:
        raise ConfigError(config, None, f"not a configuration of a simulated cell: {error!r}") from error
    own = out / "cell.yaml"
    own.write_text(
        f"# {config} with the ports of this run\n" + yaml.safe_dump(data, sort_keys=False), encoding="utf-8"
    )
    return own


def _follow(
    story: _Story,
    daemon: _Child,
    plc: _Child,
    sim: _Child,
    clock: MonotonicClock,
    asked: threading.Event,
    until: float,
) -> str | None:
    """Show what happens until the PLC's program ends; otherwise what went wrong."""
    with selectors.DefaultSelector() as selector:
        for child in (daemon, plc, sim):
            assert child.process.stdout is not None
            selector.register(child.process.stdout, selectors.EVENT_READ, child)
        while clock.now() < until:
            for key, _ in selector.select(0.5):
                child = key.data
                assert isinstance(child, _Child)
                for line in child.read():
                    if child is plc:
                        story.plc(line)
                    elif child is daemon:
                        story.daemon(line)
                if child.over:
                    selector.unregister(key.fileobj)
            # Ctrl-C reaches the children as well, so ask this first
            if asked.is_set():
                return "asked to end"
            if plc.over:
                return None
            for child in (daemon, sim):
                if child.over:
                    return f"the {child.name} process ended by itself"
    return "the time was over before the tray was empty"


def _truth(sim: _Child) -> Line:
    """What the simulated cell counted, in its last line."""
    sim.end(_END_S)
    last: Line = {}
    while not sim.over:
        for line in sim.read():
            if line.get("event") == "ended":
                last = line
    return last


def _verdict(
    story: _Story,
    out: Path,
    failed: str | None,
    daemon_code: int | None,
    plc_code: int | None,
    truth: Line,
    took_s: float,
) -> int:
    in_box = truth.get("in_box")
    good = (
        failed is None
        and in_box == story.sticks
        and story.picked == story.sticks
        and plc_code == 0
        and daemon_code == 0
        and not story.violations
    )
    attempts = [r for r in story.results if r.get("outcome") in ("PICKED", "MISSED")]
    summary: Line = {
        "good": good,
        "sticks": story.sticks,
        "picked": story.picked,
        "in_box": in_box,
        "attempts": len(attempts),
        "orders_closed": story.closed,
        "handshake_errors": list(story.violations),
        "daemon_exit": daemon_code,
        "plc_exit": plc_code,
        "took_s": round(took_s, 1),
        "detector_median_s": _median([r.get("durations_s") for r in story.results]),
        "simulated_cell": truth,
        "failed": failed,
    }
    (out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    colour = "green" if good else "red"
    story.console.print(
        f"[{colour}]{story.picked} of {story.sticks} picked[/{colour}] ({in_box} lie in the box), "
        f"{story.closed} handshakes closed, {len(story.violations)} handshake errors, "
        f"daemon exit {daemon_code}, {took_s:.0f} s. Overlays and summary in {out}/"
    )
    return 0 if good else 1


def _median(durations: list[Json]) -> float | None:
    finds = [d.get("find") for d in durations if isinstance(d, dict)]
    numbers = sorted(f for f in finds if isinstance(f, int | float))
    return numbers[len(numbers) // 2] if numbers else None
