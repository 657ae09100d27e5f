"""The daemon: start order, signals, the service manager, stop order. The main thread does nothing else.

Ending: refuse orders, fire the cell's token (a running move halts the arm, the order ends as aborted),
let the PLC thread publish that, then close. All within five seconds.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from cell import config as configuration
from cell import wiring
from cell.alarm_table import Condition
from cell.drift import DriftWatch
from cell.ending import EndRequest
from cell.faults import FaultCode
from cell.journal import Journal
from cell.last_good import usable
from cell.logs import logger
from cell.loop import SERVICE_ENDS, CellLoop, Channels
from cell.notify import Notifier
from cell.overlays import OverlayWriter
from cell.plc_link import PlcLink
from cell.recollection import recollect
from cell.standing import Standing
from cell.states import State
from cell.station import Look, Stage
from cell.types import CellReport
from cell.workers import Beat, BeatingClock, Latest, Mailbox, Worker, WorkerGroup
from drivers.timing import MonotonicClock, StopToken
from vision.default import warm_up

log = logger("daemon")

_TICK_S: Final = 0.5
_CELL_LIMIT_S: Final = 6.0
"""Longest the cell thread may go without waiting on its token: one look and one detection."""
_PLC_LIMIT_S: Final = 3.0
_END_CELL_S: Final = 3.0
_END_OTHERS_S: Final = 0.8


def run(config_path: Path, last_good: Path | None = None) -> int:
    """Run until SIGTERM or SIGINT; the exit code. ``last_good`` as in `cell.last_good`.

    Raises
    ------
    ConfigError, CalibrationError
        Before anything is opened.
    """
    config, refused = usable(config_path, last_good)
    journal = Journal(config.files.journal)
    journal.open()
    try:
        daemon = _Daemon(config, config_path, journal, refused)
        log.info("detector_warming_up")
        warm_up()  # may take seconds; nothing is open yet, so a signal may simply end the process
        with EndRequest() as asked:
            return daemon.run(asked)
    finally:
        journal.close()


class _Daemon:
    """What lives as long as the process."""

    def __init__(
        self, config: configuration.CellConfig, path: Path, journal: Journal, refused: str | None
    ) -> None:
        self._clock = MonotonicClock()
        self._notifier = Notifier()
        self._stalled: set[str] = set()
        self._workers = WorkerGroup(self._clock)
        self._journal = journal
        self._cell_journal = Journal(config.files.journal)
        self._report = Latest(CellReport(), self._clock)
        cell_beat = Beat("cell", _CELL_LIMIT_S, self._clock)
        cell_clock = BeatingClock(self._clock, cell_beat)
        cell_stop, plc_stop = StopToken(cell_clock), StopToken(self._clock)
        overlay_stop = StopToken(self._clock)
        self._overlays: OverlayWriter | None = None
        kept = config.commissioning
        self._drift = DriftWatch(kept.drift_file, kept.drift, config.files.calibration)
        parts = wiring.build(config, str(path), self._clock, cell_clock, self._progress, self._looked)
        if config.files.overlays is not None:
            beat = Beat("overlays", 30.0, self._clock)
            self._overlays = OverlayWriter(
                config.files.overlays, parts.calibration.stereo, overlay_stop, beat
            )
            self._overlay_worker = Worker(
                name="overlays", body=self._overlays.run, stop=overlay_stop, beat=beat
            )
        channels = Channels(inbox=Mailbox(64), results=Mailbox(8), report=self._report)
        parts.station.places.keep_in(self._cell_journal)
        standing = Standing(
            config.files.state_folder,
            self._clock,
            self._cell_journal.counted_after,
            config.operation.planned,
        )
        standing.condition(Condition.CONFIG_LAST_GOOD, refused)
        standing.condition(Condition.CALIBRATION_DRIFT, self._drift.drifted())
        self._standing = standing
        self._cell = CellLoop(
            parts.station, parts.devices, channels, self._cell_journal, cell_stop, cell_beat, standing
        )
        self._cell_worker = Worker(name="cell", body=self._cell.run, stop=cell_stop, beat=cell_beat)
        plc_beat = Beat("plc", _PLC_LIMIT_S, self._clock)
        boot = journal.boot()
        link = PlcLink(parts.plc, recollect(journal, boot), channels, journal, plc_stop, cell_stop, plc_beat)
        self._plc_worker = Worker(name="plc", body=link.run, stop=plc_stop, beat=plc_beat)
        log.info(
            "daemon_started",
            name=config.name,
            config=str(path),
            calibration=str(parts.calibration.path),
            units=parts.calibration.units,
            boot=boot,
            drivers={
                "left": config.cameras.left.driver,
                "right": config.cameras.right.driver,
                "robot": config.robot.driver,
                "gripper": config.gripper.driver,
                "plc": config.plc.driver,
            },
        )

    def _progress(self, stage: Stage) -> None:
        self._cell.progress(stage)

    def _looked(self, look: Look) -> None:
        self._drift.look(look.scene, look.part.code, look.part.length_m)
        self._standing.condition(Condition.CALIBRATION_DRIFT, self._drift.drifted())
        if self._overlays is not None:
            self._overlays.put(look)

    # ------------------------------------------------------------------ life

    def run(self, asked: EndRequest) -> int:
        """Start everything, feed the watchdog while all make progress, end everything."""
        self._cell_journal.open()
        for worker in self._all():
            worker.beat()
            self._workers.start(worker)
        self._notifier.ready("running")
        failure: tuple[str, BaseException] | None = None
        told = ""
        while not asked.wait(_TICK_S):
            failure = self._workers.failure()
            if failure is not None:
                break
            told = self._tell(told)
        return self._finish(failure)

    def _all(self) -> list[Worker]:
        workers = [self._plc_worker, self._cell_worker]
        return workers if self._overlays is None else [self._overlay_worker, *workers]

    def _tell(self, told: str) -> str:
        """Feed the watchdog only while every worker makes progress; say in one line how it is."""
        stalled = self._workers.stalled()
        if not stalled:
            self._notifier.alive()
        names = {beat.name for beat in stalled}
        for beat in stalled:
            if beat.name not in self._stalled:
                log.error(
                    "worker_stalled", worker=beat.name, age_s=round(beat.age_s(), 1), limit_s=beat.limit_s
                )
        self._stalled = names
        report = self._report.get()
        status = f"{State(report.state).name.lower()}, {report.total_picks} picked"
        if report.fault_code:
            status += f", fault {report.fault_code} {FaultCode(report.fault_code).name}"
        if status != told:
            self._notifier.status(status)
        return status

    def _finish(self, failure: tuple[str, BaseException] | None) -> int:
        self._notifier.stopping()
        if failure is not None:
            name, error = failure
            log.error("worker_failed", worker=name, exc_info=error)
        late = [] if self._workers.end("cell", SERVICE_ENDS, _END_CELL_S) else ["cell"]
        if not self._workers.end("plc", SERVICE_ENDS, _END_OTHERS_S):
            late.append("plc")
        if self._overlays is not None and not self._workers.end("overlays", SERVICE_ENDS, _END_OTHERS_S):
            late.append("overlays")
        for name in late:
            log.error("worker_did_not_end", worker=name)
        self._cell_journal.close()
        self._notifier.close()
        failed = failure is not None or bool(late)
        log.info("daemon_ended", failed=failed)
        return 1 if failed else 0
