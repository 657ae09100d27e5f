"""Whatever comes, goes, flickers, is acknowledged or shelved: no alarm is lost, none is made up."""

from __future__ import annotations

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from cell.alarm_table import TABLE, AlarmCode, Condition, Priority
from cell.alarms import (
    SHELVED_MOST_S,
    Alarms,
    AlarmState,
    ShelvingRefused,
    acknowledge,
    first_out,
    shelve,
    standing,
    unshelve,
    update,
)
from cell.faults import FaultCode

CODES: list[AlarmCode] = [FaultCode.PROTECTIVE_STOP, FaultCode.PLC_SILENT, Condition.BIN_EMPTY]


class Panel(RuleBasedStateMachine):
    """A naive book beside the machine: since when each condition is there, what was seen and shelved."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 100.0
        self.alarms: Alarms = {}
        self.present: dict[AlarmCode, float] = {}
        self.absent: dict[AlarmCode, float] = dict.fromkeys(CODES, 0.0)
        self.active: set[AlarmCode] = set()
        self.unseen: set[AlarmCode] = set()
        self.shelved: dict[AlarmCode, float] = {}
        self.came: dict[AlarmCode, int] = dict.fromkeys(CODES, 0)
        self.step()

    def step(self) -> None:
        self.alarms = update(self.alarms, dict.fromkeys(self.present, "here"), self.now)
        for code in CODES:
            row = TABLE[code]
            here = code in self.present
            if here and code not in self.active and self.now - self.present[code] >= row.on_delay_s:
                self.active.add(code)
                self.unseen.add(code)
                self.came[code] += 1
            gone = not here and self.now - self.absent[code] >= row.off_delay_s
            if gone and code in self.active:
                self.active.discard(code)
            if code in self.shelved and self.now >= self.shelved[code]:
                del self.shelved[code]

    @rule(code=st.sampled_from(CODES))
    def comes(self, code: AlarmCode) -> None:
        self.present.setdefault(code, self.now)
        self.step()

    @rule(code=st.sampled_from(CODES))
    def goes(self, code: AlarmCode) -> None:
        if self.present.pop(code, None) is not None:
            self.absent[code] = self.now
        self.step()

    @rule(passed_s=st.sampled_from([0.1, 0.9, 2.5, 4.0, 3600.0]))
    def time_passes(self, passed_s: float) -> None:
        self.now += passed_s
        self.step()

    @rule(code=st.sampled_from([*CODES, None]))
    def is_acknowledged(self, code: AlarmCode | None) -> None:
        self.alarms = acknowledge(self.alarms, code)
        seen = set(CODES) if code is None else {code}
        self.unseen -= seen - set(self.shelved)

    @rule(code=st.sampled_from(CODES), for_s=st.sampled_from([1.0, 600.0, SHELVED_MOST_S, 1e6, 0.0]))
    def is_shelved(self, code: AlarmCode, for_s: float) -> None:
        if for_s > SHELVED_MOST_S or for_s <= 0 or TABLE[code].priority is Priority.HIGH:
            with pytest.raises(ShelvingRefused):
                shelve(self.alarms, code, for_s, self.now)
            return
        self.alarms = shelve(self.alarms, code, for_s, self.now)
        self.shelved[code] = self.now + for_s

    @rule(code=st.sampled_from(CODES))
    def is_unshelved(self, code: AlarmCode) -> None:
        self.alarms = unshelve(self.alarms, code)
        self.shelved.pop(code, None)

    @invariant()
    def the_panel_shows_what_the_book_says(self) -> None:
        for code in CODES:
            alarm = self.alarms[code]
            if code in self.shelved:
                assert alarm.state is AlarmState.SHELVED
            elif code in self.active:
                seen = code not in self.unseen
                assert alarm.state is (AlarmState.ACKNOWLEDGED if seen else AlarmState.UNACKNOWLEDGED)
            else:
                seen = code not in self.unseen
                assert alarm.state is (AlarmState.NORMAL if seen else AlarmState.RETURNED)
            assert alarm.count == self.came[code]

    @invariant()
    def others_stay_silent(self) -> None:
        assert {code for code, _ in standing(self.alarms)} <= set(CODES)
        first = first_out(self.alarms)
        shown = self.active - set(self.shelved)
        assert (first is None) is (not shown)
        assert first is None or first in shown


Panel.TestCase.settings = settings(max_examples=80, stateful_step_count=40, deadline=None)
TestPanel = Panel.TestCase
