"""What can happen to a cell in a bad night, by name."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable

from tests.lab.chaos import Fault, Night
from tests.system.processes import START_S, until


def restart_plc(night: Night) -> None:
    """Power off and on; it remembers the orders it gave."""
    with night.plc.program.lock:
        night.observer.strange += night.plc.program.violations
    night.restart_plc(night.rng.choice((0.0, 0.3, 1.0)))
    night.plc.sequence = night.last_seq
    with night.plc.program.lock:
        night.plc.program.rules.remembered(night.observer.orders)
        night.plc.program.rules.ordered(night.last_seq)  # it may come back to a result of this one


def pull_cable(night: Night) -> None:
    night.cable.pull()
    time.sleep(night.rng.choice((0.05, 0.3, 1.0, 2.0)))
    night.cable.plug()


def swallow(night: Night) -> None:
    night.cable.swallow()
    time.sleep(night.rng.choice((0.2, 0.8, 2.0)))
    night.cable.plug()


def kill_daemon(night: Night) -> None:
    night.daemon.kill()
    until(lambda: not night.cell.ask("status").flag("arm_moving"), 3.0, "the arm stands")
    night.start_daemon()
    night.daemon.wait_for("state_changed", START_S, after="IDLE")


def fill_disk(night: Night) -> None:
    limits = resource.prlimit(night.daemon.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(night.daemon.pid, resource.RLIMIT_FSIZE, (0, limits[1]))
    time.sleep(night.rng.uniform(0.3, 1.5))
    resource.prlimit(night.daemon.pid, resource.RLIMIT_FSIZE, limits)


def fill_disk_at_once(night: Night) -> None:
    """Full when the order is read; somebody makes room once it has been answered."""
    limits = resource.prlimit(night.daemon.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(night.daemon.pid, resource.RLIMIT_FSIZE, (0, limits[1]))
    night.room = lambda: resource.prlimit(night.daemon.pid, resource.RLIMIT_FSIZE, limits)


def _fault(name: str, eye: str | None = None) -> Callable[[Night], None]:
    def bring_about(night: Night) -> None:
        if eye is None:
            night.cell.fault(name)
        else:
            night.cell.fault(name, eye=eye)

    return bring_about


FAULTS = (
    Fault(name="dropped part", before=_fault("drop_next")),
    Fault(name="missed part", before=_fault("miss_next")),
    Fault(name="camera silent", before=_fault("camera_silent", "left")),
    Fault(name="camera black", before=_fault("camera_black", "right")),
    Fault(name="camera frozen", before=_fault("camera_freeze", "left")),
    Fault(name="disk full before the order", before=fill_disk_at_once),
    Fault(name="PLC restart", during=restart_plc),
    Fault(name="cable pulled", during=pull_cable),
    Fault(name="switch dead", during=swallow),
    Fault(name="protective stop", during=_fault("protective_stop")),
    Fault(name="emergency stop", during=_fault("emergency_stop")),
    Fault(name="arm frozen", during=_fault("robot_frozen")),
    Fault(name="daemon killed", during=kill_daemon),
    Fault(name="disk full", during=fill_disk),
    Fault(name="torn write"),
    Fault(name="duplicate sequence"),
    Fault(name="skipped sequence"),
)
