"""The PLC thread's half of the cell with a scripted PLC."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from cell import handshake
from cell.journal import Journal
from cell.loop import Channels, Ticket
from cell.plc_link import PERIOD_S, PlcLink
from cell.states import Event, State
from cell.types import CellReport, Outcome, PickResult
from cell.workers import Beat, Latest, Mailbox
from drivers.errors import DeviceTimeout, DeviceUnavailable, DriverError
from drivers.timing import StopToken
from drivers.types import PlcInputs, PlcOutputs, ResultCode
from tests.fakes.clock import FakeClock
from tests.fakes.plc import IDLE, FakePlc

READY = CellReport(state=int(State.IDLE), accepting=True)


class RealPlc(FakePlc):
    """As a real driver: refuses before `open`, and a broken exchange takes ``limit_s``."""

    limit_s = 0.0
    cut = False

    def exchange(self, outputs: PlcOutputs) -> PlcInputs:
        if not self.is_open:
            raise DeviceUnavailable(self.name, "not open")
        try:
            if self.cut:
                self.calls.append("exchange")
                raise DeviceTimeout(self.name, "no answer in 0.3 s")
            return super().exchange(outputs)
        except DriverError:
            clock = self._clock
            assert isinstance(clock, FakeClock)
            clock.turn(self.limit_s)
            raise


@dataclass(slots=True)
class Side:
    """The PLC thread's half with a scripted PLC; the other half is what the test does to the channels."""

    journal: Journal
    clock: FakeClock = field(default_factory=FakeClock)
    accepted: int = 0
    finished: PickResult | None = None
    plc: RealPlc = field(init=False)
    inbox: Mailbox[Ticket | Event] = field(init=False)
    results: Mailbox[PickResult] = field(init=False)
    report: Latest[CellReport] = field(init=False)
    stop: StopToken = field(init=False)
    cell_stop: StopToken = field(init=False)
    link: PlcLink = field(init=False)

    def __post_init__(self) -> None:
        self.plc = RealPlc(self.clock)
        self.inbox = Mailbox(64)
        self.results = Mailbox(8)
        self.report = Latest(READY, self.clock)
        self.stop, self.cell_stop = StopToken(self.clock), StopToken(self.clock)
        self.link = PlcLink(
            self.plc,
            handshake.begin(5, self.accepted, self.finished),
            Channels(inbox=self.inbox, results=self.results, report=self.report),
            self.journal,
            self.stop,
            self.cell_stop,
            Beat("plc", 3.0, self.clock),
        )

    def turns(self, count: int) -> None:
        for _ in range(count):
            self.link.turn()
            self.clock.turn(PERIOD_S)

    def up(self) -> None:
        """The PLC counts and has shown enable low once."""
        self.plc.then(replace(IDLE, enable=False, heartbeat=1), replace(IDLE, enable=False, heartbeat=2))
        self.plc.then(replace(IDLE, heartbeat=3))
        self.turns(4)
        self.taken()

    def wants(self, seq: int, **changes: object) -> None:
        self.plc.then(replace(IDLE, cmd_seq=seq, heartbeat=100 + seq, **changes))  # type: ignore[arg-type]

    def taken(self) -> list[Ticket | Event]:
        items = []
        while (item := self.inbox.take(0.0)) is not None:
            items.append(item)
        return items

    @property
    def last(self) -> PlcOutputs:
        return self.plc.sent[-1]


def done(seq: int, code: ResultCode = ResultCode.OK) -> PickResult:
    return PickResult(request_id=seq, code=code, outcome=Outcome.PICKED, quantity=1)
