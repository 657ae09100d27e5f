"""Where parts are put: places in rows and columns, taken one after the other, remembered in the journal."""

from __future__ import annotations

from typing import Protocol

from cell.operation import GridConfig


class Book(Protocol):
    """Where it is durable how many places are taken. Raises `JournalError` where it cannot be written."""

    def places_taken(self) -> int: ...
    def take_place(self) -> None: ...
    def free_places(self) -> None: ...


class _Memory:
    """For a cell without a journal: as long as the process lives."""

    def __init__(self) -> None:
        self._taken = 0

    def places_taken(self) -> int:
        return self._taken

    def take_place(self) -> None:
        self._taken += 1

    def free_places(self) -> None:
        self._taken = 0


class Places:
    """The places of one pattern. Used by the cell thread.

    A pattern of one place is a box: it is never full.
    """

    def __init__(self, grid: GridConfig | None = None, book: Book | None = None) -> None:
        self._grid = grid or GridConfig()
        self._book = book or _Memory()

    def keep_in(self, book: Book) -> None:
        """Remember across restarts."""
        self._book = book

    @property
    def _count(self) -> int:
        return self._grid.rows * self._grid.columns

    @property
    def any_free(self) -> bool:
        """False when every place is taken, and that is to be reported."""
        wraps = self._grid.when_full == "wrap"
        return self._count == 1 or wraps or self._book.places_taken() < self._count

    def take(self) -> tuple[float, float] | None:
        """The next place, x and y (m) from the drop position; None when none is free."""
        if self._count == 1:
            return 0.0, 0.0
        if not self.any_free:
            return None
        number = self._book.places_taken() % self._count
        self._book.take_place()
        row, column = divmod(number, self._grid.columns)
        down, along = self._grid.row_pitch_m, self._grid.column_pitch_m
        return row * down[0] + column * along[0], row * down[1] + column * along[1]

    def free(self) -> None:
        """The tray has been changed: all are free."""
        self._book.free_places()
