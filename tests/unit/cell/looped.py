"""The cell thread's loop over scripted doubles, with every report and result kept."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from cell.journal import Journal
from cell.loop import SERVICE_ENDS, CellLoop, Channels, Ticket
from cell.states import Event, State
from cell.types import CellReport, PickResult
from cell.workers import Beat, Latest, Mailbox
from drivers.timing import StopToken
from tests.fakes.inbox import ClockedMailbox
from tests.fakes.station import Bench, order


class Reports(Latest[CellReport]):
    """Keeps every report that was published."""

    def __init__(self, cell: Bench) -> None:
        super().__init__(CellReport(), cell.clock)
        self.all: list[CellReport] = []

    def put(self, value: CellReport) -> None:
        self.all.append(value)
        super().put(value)


class Results(Mailbox[PickResult]):
    """Keeps what the journal knew of the last order when each result was handed out."""

    def __init__(self, journal: Journal) -> None:
        super().__init__(8)
        self._journal = journal
        self.known: list[PickResult | None] = []

    def put(self, item: PickResult) -> None:
        self.known.append(self._journal.last()[1])
        super().put(item)


@dataclass(slots=True)
class Cell:
    """A loop over scripted doubles; what is planned happens at its time, then the service ends."""

    bench: Bench
    journal: Journal
    path: Path
    reports: Reports = field(init=False)
    results: Results = field(init=False)
    inbox: ClockedMailbox[Ticket | Event] = field(init=False)
    stop: StopToken = field(init=False)
    loop: CellLoop = field(init=False)
    began: float = field(init=False)

    def __post_init__(self) -> None:
        clock = self.bench.clock
        self.reports = Reports(self.bench)
        self.results = Results(self.journal)
        self.inbox = ClockedMailbox(64, clock)
        self.stop = StopToken(clock)
        self.began = clock.now()
        self.loop = CellLoop(
            replace(self.bench.station, progress=lambda stage: self.loop.progress(stage)),
            self.bench.devices,
            Channels(inbox=self.inbox, results=self.results, report=self.reports),
            self.journal,
            self.stop,
            Beat("cell", 6.0, clock),
        )

    def at(self, when_s: float, action: Callable[[], None]) -> None:
        self.bench.clock.at(self.began + when_s, action)

    def send(self, when_s: float, *items: Event | Ticket) -> None:
        """Put events or orders into the inbox; an order is journaled first, as the PLC thread does."""

        def put() -> None:
            for item in items:
                if isinstance(item, Ticket):
                    self.journal.accept(item.order)
                self.inbox.put(item)

        self.at(when_s, put)

    def ticket(self, **changes: object) -> Ticket:
        return Ticket(order=order(**changes), stop=self.stop.child())

    def run(self, until_s: float) -> None:
        self.at(until_s, lambda: self.stop.stop(SERVICE_ENDS))
        self.loop.run()

    @property
    def states(self) -> list[State]:
        """Published states, repetitions left out."""
        seen: list[State] = []
        for report in self.reports.all:
            if not seen or seen[-1] != report.state:
                seen.append(State(report.state))
        return seen

    def finished(self) -> list[PickResult]:
        taken = []
        while (result := self.results.take(0.0)) is not None:
            taken.append(result)
        return taken

    def rows(self, table: str, columns: str) -> list[tuple[object, ...]]:
        reader = sqlite3.connect(self.path)
        try:
            return reader.execute(f"SELECT {columns} FROM {table} ORDER BY id").fetchall()
        finally:
            reader.close()
