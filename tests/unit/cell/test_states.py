"""The state table, walked along its usual ways."""

from __future__ import annotations

import pytest

from cell.states import TABLE, Event, EventRefused, State, next_state

# OMAC PackTags, the numbers of register 3 in the status block
OMAC = {
    "CLEARING": 1,
    "STOPPED": 2,
    "STARTING": 3,
    "IDLE": 4,
    "SUSPENDED": 5,
    "EXECUTE": 6,
    "STOPPING": 7,
    "ABORTING": 8,
    "ABORTED": 9,
    "HOLDING": 10,
    "HELD": 11,
    "UNHOLDING": 12,
    "SUSPENDING": 13,
    "UNSUSPENDING": 14,
    "RESETTING": 15,
    "COMPLETING": 16,
    "COMPLETE": 17,
}


def walked(state: State, *events: Event) -> State:
    for event in events:
        state = next_state(state, event)
    return state


def test_the_numbers_are_those_of_omac() -> None:
    assert {state.name: int(state) for state in State} == OMAC


def test_a_start_ends_idle() -> None:
    assert walked(State.STOPPED, Event.RESET, Event.READY) is State.IDLE


def test_an_order_runs_and_ends_idle_again() -> None:
    way = [Event.ORDER, Event.STARTED, Event.DONE, Event.REPORTED]
    assert walked(State.IDLE, *way[:2]) is State.EXECUTE
    assert walked(State.IDLE, *way) is State.IDLE


def test_after_a_fault_only_a_reset_leads_back() -> None:
    aborted = walked(State.EXECUTE, Event.FAULT, Event.HALTED)
    assert aborted is State.ABORTED
    assert walked(aborted, Event.RESET, Event.CLEARED) is State.STOPPED


def test_a_lost_link_suspends_and_its_return_resumes() -> None:
    assert walked(State.IDLE, Event.LINK_LOST) is State.SUSPENDED
    assert walked(State.IDLE, Event.LINK_LOST, Event.LINK_UP) is State.IDLE


def test_a_hold_is_ended_by_a_person_and_not_by_the_link() -> None:
    assert walked(State.SUSPENDED, Event.HOLD) is State.HELD
    with pytest.raises(EventRefused):
        next_state(State.HELD, Event.LINK_UP)
    assert next_state(State.HELD, Event.UNHOLD) is State.IDLE


def test_a_stop_ends_stopped_from_everywhere_it_is_taken() -> None:
    takes = [state for state, event in TABLE if event is Event.STOP]
    assert {walked(state, Event.STOP, Event.HALTED) for state in takes} == {State.STOPPED}
    assert {State.EXECUTE, State.IDLE, State.HELD, State.SUSPENDED} <= set(takes)


def test_a_refused_event_names_itself_and_the_state() -> None:
    with pytest.raises(EventRefused, match="ORDER in ABORTED"):
        next_state(State.ABORTED, Event.ORDER)
