"""What holds for every sequence of events, however wild."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from cell.states import TABLE, Event, EventRefused, State, next_state

events = st.lists(st.sampled_from(Event), max_size=60)
MEANT = {State.CLEARING, State.STOPPED, State.STARTING, State.IDLE, State.SUSPENDED, State.EXECUTE}
MEANT |= {State.STOPPING, State.ABORTING, State.ABORTED, State.HELD, State.RESETTING, State.COMPLETE}


def visited(start: State, sequence: list[Event]) -> list[tuple[State, Event, State]]:
    """(before, event, after) of every event that was taken."""
    steps = []
    state = start
    for event in sequence:
        try:
            after = next_state(state, event)
        except EventRefused:
            continue
        steps.append((state, event, after))
        state = after
    return steps


@given(events)
def test_execute_is_only_reached_by_an_order_while_idle(sequence: list[Event]) -> None:
    steps = visited(State.STOPPED, sequence)
    for i, (before, event, after) in enumerate(steps):
        if after is State.EXECUTE:
            assert (before, event) == (State.STARTING, Event.STARTED)
            assert steps[i - 1] == (State.IDLE, Event.ORDER, State.STARTING)


@given(st.sampled_from(State), events)
def test_after_a_fault_nothing_but_a_reset_leads_out_of_aborted(start: State, sequence: list[Event]) -> None:
    for before, event, after in visited(start, [Event.FAULT, Event.HALTED, *sequence]):
        if before is State.ABORTED:
            assert (event, after) == (Event.RESET, State.CLEARING)
        if before is State.ABORTING:
            assert (event, after) == (Event.HALTED, State.ABORTED)


@given(events)
def test_between_a_fault_and_the_next_execute_lie_a_reset_and_an_order(sequence: list[Event]) -> None:
    since_fault: list[Event] | None = None
    for _, event, after in visited(State.STOPPED, sequence):
        if event is Event.FAULT:
            since_fault = []
        elif since_fault is not None:
            since_fault.append(event)
            if after is State.EXECUTE:
                assert since_fault.index(Event.RESET) < since_fault.index(Event.ORDER)
                since_fault = None


@given(events)
def test_a_cell_that_was_stopped_does_not_move_without_a_reset(sequence: list[Event]) -> None:
    steps = visited(State.STOPPING, sequence)
    for i, (_, _, after) in enumerate(steps):
        if after is State.EXECUTE:
            assert any(event is Event.RESET for _, event, _ in steps[:i])


@given(events)
def test_every_state_on_the_way_is_one_the_documents_describe(sequence: list[Event]) -> None:
    assert {after for _, _, after in visited(State.STOPPED, sequence)} <= MEANT


def test_every_state_but_those_of_a_fault_can_meet_one() -> None:
    for state in MEANT - {State.ABORTING, State.ABORTED}:
        assert TABLE[state, Event.FAULT] is State.ABORTING


def test_a_reset_moves_a_cell_only_out_of_stopped_and_aborted() -> None:
    assert {state for state, event in TABLE if event is Event.RESET} == {State.STOPPED, State.ABORTED}
