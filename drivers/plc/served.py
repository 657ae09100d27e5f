"""The registers the cell serves when it is the Modbus server: one image, two threads.

The PLC's requests change and read it in the server's thread; `ModbusServerPlc.exchange` shows new status
words and takes the command words in the PLC thread. Every request is one step under the lock, so a block that
is read with one request is never torn.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from drivers.plc_map import (
    COMMAND,
    COMMAND_WORDS,
    SERVER_WINDOWS,
    STATUS,
    STATUS_WORDS,
    Area,
    Block,
    Window,
    offset_of,
)
from drivers.timing import Clock

CONTROL: Final = offset_of(COMMAND, "control")
STATUS_WORD: Final = offset_of(STATUS, "status")


@dataclass(frozen=True, slots=True, kw_only=True)
class Taken:
    """What an exchange takes over. ``unwritten``: offsets the PLC has not written since the start."""

    words: tuple[int, ...]
    fetched_at: float
    unwritten: tuple[int, ...]


class ServedRegisters:
    """The image. Words in and out are unsigned 16 bit; bits are words of 0 and 1.

    `show` begins an exchange and returns the event that is set as soon as the PLC has read the status word
    (in whatever area) since then. That is what "sent" means in this role: a PLC that reads the block in
    several requests, again and again in the same order, has read every other word at least once between two
    exchanges.
    """

    def __init__(self, clock: Clock, test_words: Sequence[int]) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._command = [0] * COMMAND_WORDS
        self._written = [False] * COMMAND_WORDS
        self._status = [0] * STATUS_WORDS
        self._test = list(test_words)
        self._fetched = threading.Event()
        self._fetched_at = 0.0

    # the PLC thread

    def show(self, status: Sequence[int]) -> threading.Event:
        """From now on the PLC is shown these words; the event is set when it has read them."""
        fetched = threading.Event()
        with self._lock:
            self._status = list(status)
            self._fetched = fetched
        return fetched

    def take(self) -> Taken:
        """The command words, and when the status was last read."""
        with self._lock:
            return Taken(
                words=tuple(self._command),
                fetched_at=self._fetched_at,
                unwritten=tuple(i for i, done in enumerate(self._written) if not done),
            )

    # the server's thread

    def read(self, area: Area, address: int, count: int) -> list[int] | None:
        """What a request reads; None when it does not lie in one window."""
        window = window_of(area, address, count)
        if window is None:
            return None
        first = address - window.first
        with self._lock:
            match window.block:
                case Block.COMMAND:
                    return self._command[first : first + count]
                case Block.TEST:
                    return self._test[first : first + count]
                case Block.CONTROL_BITS:
                    return _bits(self._command[CONTROL])[first : first + count]
                case Block.STATUS:
                    if first <= STATUS_WORD < first + count:
                        self._note_fetched()
                    return self._status[first : first + count]
                case Block.STATUS_BITS:
                    self._note_fetched()
                    return _bits(self._status[STATUS_WORD])[first : first + count]

    def write(self, area: Area, address: int, values: Sequence[int]) -> bool:
        """Take over what a request writes; False when it may not be written there, and nothing is."""
        window = window_of(area, address, len(values))
        if window is None or not window.writable:
            return False
        first = address - window.first
        with self._lock:
            if window.block is Block.COMMAND:
                self._command[first : first + len(values)] = values
                self._written[first : first + len(values)] = [True] * len(values)
                return True
            bits = _bits(self._command[CONTROL])
            bits[first : first + len(values)] = values
            self._command[CONTROL] = sum(1 << i for i, on in enumerate(bits) if on)
            self._written[CONTROL] = True
            return True

    def _note_fetched(self) -> None:
        self._fetched_at = self._clock.now()
        self._fetched.set()


def window_of(area: Area, address: int, count: int) -> Window | None:
    """The window a request lies in, with all it asks for.

    >>> window_of(Area.HOLDING_REGISTER, 100, 40).block.value
    'status block'
    >>> window_of(Area.HOLDING_REGISTER, 20, 10)
    """
    return next(
        (
            window
            for window in SERVER_WINDOWS
            if window.area is area
            and window.first <= address
            and address + count <= window.first + window.count
        ),
        None,
    )


def _bits(word: int) -> list[int]:
    return [word >> i & 1 for i in range(16)]
