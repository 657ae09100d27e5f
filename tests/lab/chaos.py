"""A cell in a bad night: its orders, and who watches. What can happen to it is in `chaos_faults`.

The watchers are not the cell's own books: the PLC's registers, where every write of the cell is noted, and
the simulated world, which counts every motion it was made to start and every part that lies somewhere.
"""

from __future__ import annotations

import random
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from drivers.plc_map import next_sequence
from drivers.types import PlcCommand, PlcOutputs, ResultCode
from tests.fakes.ports import free_port
from tests.fakes.simcell import WORLD, SimCell, sim_cell
from tests.lab.cable import Cable, cable
from tests.lab.test_soak import Sample, sample
from tests.system.handplc import HandPlc, hand_plc
from tests.system.processes import POLL_S, START_S, Daemon, until, write_config

SPEED = "60"
STICKS = 5
MOST_STUCK, FULL_TRAY = 2, 16
"""Orders in a row for which nothing could be picked; then somebody throws in more, up to so many."""
RECOVER_S = 40.0
ORDER_S = 40.0
FORGOTTEN_S = 6.0
FIRST_SEQUENCE = 65400
"""So that the numbers come round in a long night."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """What is brought about before an order is shown, and while it is carried out.

    Without either it lies in the way the order is given, and `Night.order` knows its name.
    """

    name: str
    before: Callable[[Night], None] | None = None
    during: Callable[[Night], None] | None = None


@dataclass(slots=True)
class Order:
    """One sequence number as the PLC knows it."""

    seq: int
    fault: str
    motions_before: int
    refused: int = 0
    fault_code: int = 0
    codes: set[int] = field(default_factory=set)
    motions: int = 0
    grasps_before: int = 0
    grasps: int = 0
    boxed_before: int = 0
    boxed: int = 0
    held_before: bool = False


class Observer:
    """What every PLC program has seen, and what the world says."""

    def __init__(self) -> None:
        self.orders: dict[int, Order] = {}
        self.valid = False
        self.shown = 0
        self.boot = -1
        self.strange: list[str] = []

    def wrote(self, status: PlcOutputs) -> bool:
        """Runs in the PLC's server for every write of the cell, before the PLC's own program sees it."""
        edge = status.result_valid and (
            not self.valid or status.result_seq != self.shown or status.boot_id != self.boot
        )
        self.valid, self.shown, self.boot = status.result_valid, status.result_seq, status.boot_id
        if edge:
            order = self.orders.get(status.result_seq)
            if order is None:
                self.strange.append(f"a result of {status.result_seq}, which was never ordered")
            else:
                order.codes.add(status.result_code)
                if len(order.codes) > 1:
                    self.strange.append(f"{order.seq} ended as {sorted(order.codes)} ({order.fault})")
                if order.refused:
                    self.strange.append(f"{order.seq} was refused with {order.refused} and has a result")
        return True


class Night:
    """One cell, its PLC, its cable, and the faults of one night."""

    def __init__(self, folder: Path, seed: int, cell: SimCell, stack: ExitStack) -> None:
        self.folder = folder
        self.rng = random.Random(seed)
        self.cell = cell
        self.observer = Observer()
        self.faults: Counter[str] = Counter()
        self.results: Counter[str] = Counter()
        self.fault_codes: Counter[int] = Counter()
        self.samples: list[list[Sample]] = []
        self.added = STICKS
        self.still = 0
        self.stuck = 0
        self.room: Callable[[], object] | None = None
        self.balance: dict[str, int] = {}
        self._plc_port = free_port()
        self._plc_stack = ExitStack()
        self.plc = self._new_plc()
        self.cable: Cable = stack.enter_context(cable(self._plc_port))
        self.config = written(folder, cell.port, self.cable.port)
        self.daemon = self._new_daemon()
        self.last_seq = FIRST_SEQUENCE

    # ------------------------------------------------------------------ who takes part

    def _new_plc(self) -> HandPlc:
        plc = self._plc_stack.enter_context(hand_plc(self._plc_port))
        plc.program.before_write = self.observer.wrote
        return plc

    def restart_plc(self, away_s: float) -> None:
        """Its registers are empty, its port is gone for a while."""
        self._plc_stack.close()
        self._plc_stack = ExitStack()
        time.sleep(away_s)
        self.plc = self._new_plc()

    def start_daemon(self) -> None:
        self.daemon = self._new_daemon()

    def _new_daemon(self) -> Daemon:
        running = Daemon(self.config)
        self.samples.append([])
        return running

    def end(self) -> None:
        self.daemon.end()
        self._plc_stack.close()

    # ------------------------------------------------------------------ one order

    def order(self, fault: Fault | None) -> Order:
        """One order of the PLC with one fault in it, or none; it has come to its end when this returns."""
        self.recover()
        lying = self.cell.count("in_tray")
        if lying < 2 or (self.stuck >= MOST_STUCK and lying < FULL_TRAY):
            self.stuck = 0
            self.cell.ask("add_sticks", count=STICKS)
            self.added += STICKS
        self.nothing_moved("between two orders")
        self.faults[fault.name if fault else "none"] += 1
        before = self.cell.ask("status")
        seq = next_sequence(self.last_seq)
        name = fault.name if fault else ""
        if name == "skipped sequence":
            for _ in range(self.rng.randrange(1, 50)):
                seq = next_sequence(seq)
        self.last_seq = seq
        order = Order(
            seq=seq,
            fault=name,
            motions_before=before.whole("motions"),
            grasps_before=before.whole("grasps"),
            boxed_before=before.whole("in_box"),
            held_before=before.flag("holding"),
        )
        self.observer.orders[seq] = order
        self.plc.sequence = seq
        with self.plc.program.lock:
            self.plc.program.rules.ordered(seq)
        if name == "torn write":
            # a scan that is cut in two: the number is there before its payload, which changes under way
            self.plc.change(cmd_seq=seq, cmd_code=int(PlcCommand.PICK_AND_PLACE), max_attempts=99)
            time.sleep(self.rng.uniform(0.0, 0.04))
        self.plc.change(cmd_code=int(PlcCommand.PICK_AND_PLACE), max_attempts=1)
        if fault and fault.before:
            fault.before(self)
        self.plc.change(cmd_seq=seq)
        if fault and fault.during:
            time.sleep(self.rng.uniform(0.0, 0.8))
            fault.during(self)
        self.await_end(order)
        if self.room is not None:
            self.room()
            self.room = None
        if name == "duplicate sequence":
            self.ask_again(order)
        self.close(order)
        return order

    def await_end(self, order: Order) -> None:
        """Its result, or a refusal, whatever PLC asks now."""
        ends_at = time.monotonic() + ORDER_S
        while not order.codes:
            status = self.plc.status
            if status.accepted_seq == order.seq and status.ack_code:
                order.refused, order.fault_code = status.ack_code, status.fault_code
                return
            forgotten = self.plc.program.command.cmd_seq != order.seq and status.accepted_seq != order.seq
            if forgotten and status.plc_link_ok and time.monotonic() > ends_at - ORDER_S + FORGOTTEN_S:
                order.refused = -1  # the PLC has forgotten it before anybody read it
                return
            assert time.monotonic() < ends_at, (
                f"order {order.seq} ({order.fault}) has no end; the cell shows {status}"
            )
            time.sleep(POLL_S)

    def ask_again(self, order: Order) -> None:
        """The same number shown anew, with another payload: nothing may move."""
        self.take(order.seq)
        motions = self.cell.count("motions")
        self.plc.change(cmd_seq=0, result_ack_seq=0)
        time.sleep(0.2)
        with self.plc.program.lock:
            self.plc.program.rules.ordered(order.seq)  # its result is to be published anew
        self.plc.change(cmd_code=int(PlcCommand.HOME))
        self.plc.change(cmd_seq=order.seq)
        if order.codes:
            self.plc.wait(lambda s: s.result_valid and s.result_seq == order.seq, "its result again")
        else:
            time.sleep(0.4)
        now = self.cell.count("motions")
        if now != motions and not order.refused:
            self.observer.strange.append(f"{order.seq} shown again moved the arm")

    def close(self, order: Order) -> None:
        """Take the result; the arm has come to rest, and what it did is counted to this order."""
        self.take(order.seq)
        until(lambda: not self.cell.ask("status").flag("arm_moving"), 5.0, "the arm stands")
        after = self.cell.ask("status")
        self.still = after.whole("motions")
        order.motions = self.still - order.motions_before
        order.grasps = after.whole("grasps") - order.grasps_before
        order.boxed = after.whole("in_box") - order.boxed_before
        if order.refused and order.motions:
            self.observer.strange.append(f"{order.seq} was refused, and the arm moved")
        nothing = order.codes & {int(ResultCode.COLLISION), int(ResultCode.NO_PART_FOUND)}
        self.stuck = self.stuck + 1 if nothing else 0
        for code in order.codes or {order.refused}:
            name = "FORGOTTEN" if code < 0 else ResultCode(code).name
            self.results[name if order.codes else f"refused {name}"] += 1

    def take(self, seq: int) -> None:
        """Acknowledge until the result is dropped; a restart may show it again meanwhile."""
        ends_at = time.monotonic() + 10.0
        with self.plc.program.lock:
            self.plc.program.rules.acknowledged(seq)
        self.plc.change(result_ack_seq=seq)
        # a PLC that has just restarted knows nothing until the cell has written to it
        while not self.plc.program.writes and time.monotonic() < ends_at:
            time.sleep(POLL_S)
        while self.plc.status.result_valid and time.monotonic() < ends_at:
            time.sleep(POLL_S)
        with self.plc.program.lock:
            self.plc.program.rules.closed()

    def nothing_moved(self, when: str) -> None:
        now = self.cell.count("motions")
        if self.still and now != self.still:
            self.observer.strange.append(f"{now - self.still} motions without an order {when}")

    # ------------------------------------------------------------------ after a fault

    def recover(self) -> None:
        """What people and the PLC do until the cell is ready: mend, reset, enable."""
        ends_at = time.monotonic() + RECOVER_S
        if self.daemon.process.poll() is not None:
            self.faults["daemon ended by itself"] += 1
            self.start_daemon()
        while not self.plc.status.ready:
            assert time.monotonic() < ends_at, f"the cell does not come back: {self.plc.status}"
            status = self.plc.status
            if status.fault or status.state in (2, 9):
                self.fault_codes[status.fault_code] += 1
                self.cell.mend()
                self.plc.reset()
                self._wait_a_moment(1.5)
            elif not status.ready:
                if status.result_valid:
                    self.take(status.result_seq)
                self.plc.change(enable=False)
                time.sleep(0.15)
                self.plc.change(enable=True)
                self._wait_a_moment(0.6)
        self.cell.mend()

    def _wait_a_moment(self, longest_s: float) -> None:
        began_at = time.monotonic()
        while not self.plc.status.ready and time.monotonic() - began_at < longest_s:
            time.sleep(POLL_S)

    def sampled(self, delivered: int) -> None:
        self.samples[-1].append(sample(self.daemon.pid, delivered))


def written(folder: Path, sim_port: int, plc_port: int) -> Path:
    """The demo's cell, as quick as the arm allows."""
    path = write_config(folder, sim_port, plc_port)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    data["motion"]["joints"].update(speed_rad_s=2.5, accel_rad_s2=6.0)
    data["motion"]["travel"].update(speed_m_s=1.0, accel_m_s2=3.0)
    data["motion"]["approach"].update(speed_m_s=0.4, accel_m_s2=2.0)
    world = yaml.safe_load((folder / "world.yaml").read_text(encoding="utf-8"))
    for eye in ("left", "right"):
        data["cameras"][eye].update(
            width_px=world["cameras"]["width_px"], height_px=world["cameras"]["height_px"]
        )
    data["cameras"]["look_timeout_s"] = 1.5
    data["parts"][0]["diameter_m"] = world["sticks"]["diameter_m"]
    data["files"]["calibration"] = "calibration.json"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path


def small_world(folder: Path) -> Path:
    """The demo's world with pictures of half the size and thicker sticks: this is about the machine."""
    world = yaml.safe_load(WORLD.read_text(encoding="utf-8"))
    cameras = world["cameras"]
    cameras["width_px"], cameras["height_px"] = cameras["width_px"] // 2, cameras["height_px"] // 2
    for eye in ("left", "right"):
        for key in ("focal_px", "centre_px"):
            cameras[eye][key] = [value / 2 for value in cameras[eye][key]]
    world["sticks"].update(diameter_m=0.0076, wall_margin_m=0.045)
    path = folder / "world.yaml"
    path.write_text(yaml.safe_dump(world), encoding="utf-8")
    subprocess.run(
        [
            *(sys.executable, "-m", "drivers.sim.cell", "--world", str(path)),
            *("--calibration-out", str(folder / "calibration.json")),
        ],
        check=True,
    )
    return path


@contextmanager
def night(folder: Path, seed: int) -> Iterator[Night]:
    """A cell that is ready for its first order."""
    with ExitStack() as stack:
        world = small_world(folder)
        cell = stack.enter_context(
            sim_cell("--speed", SPEED, "--seed", str(seed % 1000), "--sticks", str(STICKS), world=world)
        )
        made = Night(folder, seed, cell, stack)
        try:
            made.daemon.wait_for("state_changed", START_S, after="IDLE")
            yield made
        finally:
            made.end()
