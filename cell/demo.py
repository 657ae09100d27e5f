"""The demo: daemon, simulated cell, simulated UR controller and simulated PLC, a process each; the PLC
empties the tray.

Nothing is simulated in here. The daemon is the one of `mikado run`; the PLC orders over Modbus TCP, the arm
is driven over RTDE. The verdict does not rest on the daemon's word: the simulated cell counts what lies in
its box, the PLC checks every handshake.
"""

from __future__ import annotations

import json
import os
import selectors
import signal
import threading
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Final, Literal

import yaml
from rich.console import Console

from cell.demo_children import END_S, Child, Children, Json, Line, free_loopback, free_port
from cell.errors import ConfigError, UsageError
from drivers.timing import MonotonicClock
from vision.default import warm_up

_MADE: Final = (
    "cell.yaml",
    "demo.sqlite",
    "demo.sqlite-wal",
    "demo.sqlite-shm",
    "plc.json",
    "summary.json",
    "drift.json",
)
_LOGS: Final = ("daemon.log", "plc.log", "sim.log", "ur.log")


@dataclass(slots=True)
class _Story:
    """What the processes told, for the terminal and the summary."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What is to be run. ``driver``: ur runs the production driver against a simulated controller on the
    wire, sim the simulated cell's own arm. ``plc``: the simulated PLC's role on Modbus TCP. ``speed``
    simulated seconds per second."""

    config: Path
    out: Path
    driver: Literal["ur", "sim"]
    plc: Literal["server", "client"]
    sticks: int
    seed: int
    speed: float
    deadline_s: float

    @property
    def world(self) -> Path:
        """The simulated cell's file, beside the configuration."""
        return self.config.parent / "world.yaml"

    @property
    def arm(self) -> Path:
        """The sections of a UR arm and of a gripper wired to it, beside the configuration."""
        return self.config.parent / "ur.yaml"


def demo(wish: Wish) -> int:
    """Run the demo; 0 only if every stick was picked and every handshake closed.

    Raises
    ------
    UsageError, ConfigError
        Nothing to run with, nowhere to write, or a process that does not start.
    """
    if wish.sticks < 1:
        raise UsageError(f"--sticks {wish.sticks}: at least one")
    for needed in (wish.config, wish.world, *((wish.arm,) if wish.driver == "ur" else ())):
        if not needed.is_file():
            raise UsageError(f"{needed}: not found; run the demo in the checkout, or give --config")
    _clear(wish.out)
    console = Console(highlight=False, soft_wrap=True)
    console.print("Compiling the detector: about three minutes on a new machine, a second later on.")
    # here and not while the PLC waits for the cell to be ready
    warm_up()
    clock = MonotonicClock()
    asked = _asked_to_end()
    children = Children(wish.out, clock, asked)
    try:
        return _play(wish, console, children, asked, clock)
    finally:
        children.end()


def _asked_to_end() -> threading.Event:
    """Set by SIGTERM or Ctrl-C: the children must not outlive the demo."""
    asked = threading.Event()

    def ask(_number: int, _frame: FrameType | None) -> None:
        asked.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, ask)
    return asked


def _play(
    wish: Wish, console: Console, children: Children, asked: threading.Event, clock: MonotonicClock
) -> int:
    sim = children.start(
        "sim",
        [
            *("drivers.sim.cell", "--world", str(wish.world), "--port", "0"),
            *("--speed", str(wish.speed), "--seed", str(wish.seed), "--sticks", str(wish.sticks)),
        ],
    )
    sim_port = children.port(sim)
    data = _settings(wish.config)
    said = f"arm and gripper by driver: sim, time x{wish.speed:g}"
    watched = [sim]
    if wish.driver == "ur":
        host, controller = _controller(wish, data, children, sim_port)
        watched.append(controller)
        said = f"simulated UR controller at {host} (RTDE, dashboard, pins), time x{wish.speed:g}"
    polls = wish.plc == "client"
    where = ["--connect", f"127.0.0.1:{free_port()}"] if polls else ["--port", "0"]
    plc = children.start(
        "plc", ["drivers.sim.plc", *where, "--orders", "until-empty", "--out", str(wish.out / "plc.json")]
    )
    plc_port = children.port(plc)
    if polls:
        data["plc"] = {"driver": "modbus_server", "bind": "127.0.0.1", "peers": ["127.0.0.1"]}
    own = _own_config(wish, data, sim_port, plc_port)
    console.print(
        f"simulated cell on port {sim_port} ({wish.sticks} sticks, seed {wish.seed}), {said}, "
        f"simulated PLC {'polls' if polls else 'on'} port {plc_port} (Modbus TCP), daemon: mikado run {own}"
    )
    began_at = clock.now()
    daemon = children.start("daemon", ["cell", "run", str(own), "--json"], merge=True)
    story = _Story(console=console, sticks=wish.sticks)
    failed = _follow(story, daemon, plc, watched, clock, asked, began_at + wish.deadline_s)
    if failed is not None:
        console.print(f"[red]{failed}[/red]; see {wish.out}/*.log")
    daemon_code = daemon.end(END_S)
    plc_code = plc.end(END_S)
    told = [_last_words(child) for child in watched[1:]]  # before its world ends
    truth = _last_words(sim)
    arm = told[0] if told else None
    return _verdict(story, wish, failed, daemon_code, plc_code, truth, arm, clock.now() - began_at)


def _controller(wish: Wish, data: dict[str, Json], children: Children, sim_port: int) -> tuple[str, Child]:
    """Start a UR controller whose arm is the simulated cell's, and configure its driver."""
    arm = _settings(wish.arm)
    robot, gripper = arm.get("robot"), arm.get("gripper")
    tcp = robot.get("tcp_m_rad") if isinstance(robot, dict) else None
    if not isinstance(robot, dict) or not isinstance(gripper, dict) or not isinstance(tcp, list):
        raise ConfigError(wish.arm, None, "sections robot (with tcp_m_rad) and gripper are needed")
    host = free_loopback()
    robot["host"] = host
    data["robot"], data["gripper"], data["allow_mixed"] = robot, gripper, True
    controller = children.start(
        "ur",
        [
            *("drivers.sim.ur_controller", "--host", host, "--model", str(robot.get("model"))),
            *("--tcp=" + ",".join(str(v) for v in tcp), "--payload", str(robot.get("payload_kg"))),
            *("--world-port", str(sim_port), "--time-scale", str(wish.speed)),
        ],
    )
    children.first_line(controller)
    return host, controller


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


def _settings(path: Path) -> dict[str, Json]:
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError(path, None, f"cannot be read: {error}") from error
    if not isinstance(data, dict):
        raise ConfigError(path, None, "not a YAML mapping")
    return data


def _own_config(wish: Wish, data: dict[str, Json], sim_port: int, plc_port: int) -> Path:
    """The demo's configuration with the addresses of this run in it, beside its output."""
    try:
        cameras, files = _section(data, "cameras"), _section(data, "files")
        simulated = [_section(cameras, "left"), _section(cameras, "right")]
        simulated += [_section(data, name) for name in ("robot", "gripper")]
        for section in simulated:
            if section.get("driver") == "sim":
                section["port"] = sim_port
        _section(data, "plc")["port"] = plc_port
        for name in ("calibration", "empty_tray"):
            if name == "calibration" or name in files:
                files[name] = os.path.relpath(wish.config.parent / str(files[name]), wish.out)
    except KeyError as error:
        raise ConfigError(
            wish.config, None, f"not a configuration of a simulated cell: {error} is missing"
        ) from error
    own = wish.out / "cell.yaml"
    own.write_text(
        f"# {wish.config} with the addresses of this run\n" + yaml.safe_dump(data, sort_keys=False),
        encoding="utf-8",
    )
    return own


def _section(data: dict[str, Json], name: str) -> dict[str, Json]:
    section = data[name]
    if not isinstance(section, dict):
        raise KeyError(name)
    return section


def _follow(
    story: _Story,
    daemon: Child,
    plc: Child,
    watched: list[Child],
    clock: MonotonicClock,
    asked: threading.Event,
    until: float,
) -> str | None:
    """Show what happens until the PLC's program ends; otherwise what went wrong."""
    with selectors.DefaultSelector() as selector:
        for child in (daemon, plc, *watched):
            assert child.process.stdout is not None
            selector.register(child.process.stdout, selectors.EVENT_READ, child)
        while clock.now() < until:
            for key, _ in selector.select(0.5):
                child = key.data
                assert isinstance(child, Child)
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
            for child in (daemon, *watched):
                if child.over:
                    return f"the {child.name} process ended by itself"
    return "the time was over before the tray was empty"


def _last_words(child: Child) -> Line:
    """What a simulated device counted, in its last line."""
    child.end(END_S)
    last: Line = {}
    while not child.over:
        for line in child.read():
            last = line
    return last


def _verdict(
    story: _Story,
    wish: Wish,
    failed: str | None,
    daemon_code: int | None,
    plc_code: int | None,
    truth: Line,
    arm: Line | None,
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
        "driver": wish.driver,
        "plc": wish.plc,
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
        "simulated_controller": arm,
        "failed": failed,
    }
    out = wish.out
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
