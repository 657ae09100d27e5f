"""States and events of the cell, PackML (ISA-TR88.00.02) names and OMAC numbers; a pure table.

*Suspended* is blocked from outside (the PLC's link), *held* waits for a person here, *aborted* is a fault.
"""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import Final


class State(IntEnum):
    """PackML states with the numbers of OMAC's PackTags (not those of OPC 30060)."""

    CLEARING = 1
    STOPPED = 2
    STARTING = 3
    IDLE = 4
    SUSPENDED = 5
    EXECUTE = 6
    STOPPING = 7
    ABORTING = 8
    ABORTED = 9
    HOLDING = 10
    HELD = 11
    UNHOLDING = 12
    SUSPENDING = 13
    UNSUSPENDING = 14
    RESETTING = 15
    COMPLETING = 16
    COMPLETE = 17


class Event(Enum):
    """What may change the state."""

    RESET = "reset"
    READY = "ready"
    ORDER = "order"
    STARTED = "started"
    DONE = "done"
    REPORTED = "reported"
    FAULT = "fault"
    HALTED = "halted"
    CLEARED = "cleared"
    LINK_LOST = "link_lost"
    LINK_UP = "link_up"
    HOLD = "hold"
    UNHOLD = "unhold"
    STOP = "stop"
    JOURNAL_LOST = "journal_lost"
    ASK = "ask"


class EventRefused(Exception):
    """The event has no entry for the state."""


_WORKING: Final = (State.STARTING, State.EXECUTE, State.COMPLETE)

TABLE: Final[dict[tuple[State, Event], State]] = {
    (State.STOPPED, Event.RESET): State.RESETTING,
    (State.RESETTING, Event.READY): State.IDLE,
    (State.IDLE, Event.ORDER): State.STARTING,
    (State.STARTING, Event.STARTED): State.EXECUTE,
    (State.EXECUTE, Event.DONE): State.COMPLETE,
    (State.COMPLETE, Event.REPORTED): State.IDLE,
    (State.IDLE, Event.LINK_LOST): State.SUSPENDED,
    (State.SUSPENDED, Event.LINK_UP): State.IDLE,
    (State.IDLE, Event.HOLD): State.HELD,
    (State.IDLE, Event.ASK): State.HELD,
    (State.SUSPENDED, Event.HOLD): State.HELD,
    (State.HELD, Event.UNHOLD): State.IDLE,
    (State.ABORTING, Event.HALTED): State.ABORTED,
    (State.ABORTED, Event.RESET): State.CLEARING,
    (State.CLEARING, Event.CLEARED): State.STOPPED,
    (State.STOPPING, Event.HALTED): State.STOPPED,
    # every state that is not already a fault can meet one
    **{
        (state, Event.FAULT): State.ABORTING
        for state in (
            *_WORKING,
            State.STOPPED,
            State.RESETTING,
            State.IDLE,
            State.SUSPENDED,
            State.HELD,
            State.CLEARING,
            State.STOPPING,
        )
    },
    **{
        (state, Event.STOP): State.STOPPING
        for state in (*_WORKING, State.IDLE, State.SUSPENDED, State.HELD, State.RESETTING)
    },
}


def next_state(state: State, event: Event) -> State:
    """The state after an event.

    Raises
    ------
    EventRefused
        When the table has no entry: the event means nothing in this state.

    >>> next_state(State.IDLE, Event.ORDER).name
    'STARTING'
    """
    try:
        return TABLE[state, event]
    except KeyError:
        raise EventRefused(f"{event.name} in {state.name}") from None
