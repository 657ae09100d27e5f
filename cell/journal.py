"""The journal: SQLite on disk, one row per order, fault and state change. At-most-once lives here.

An order is durable before it is acknowledged to the PLC, a result before it is published. What was
accepted and never finished was interrupted; the next start says so and never executes it again. An order
is only taken while there is room left for its result, so that a disk that fills up stops the cell before a
motion and not after it.
"""

from __future__ import annotations

import errno
import json
import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Final

from cell.errors import ConfigError, JournalError
from cell.faults import Fault
from cell.states import State
from cell.types import Outcome, PickOrder, PickResult
from drivers.types import PlcCommand, ResultCode, ToolPose

SCHEMA_VERSION: Final = 1
ROOM_BYTES: Final = 4 * 1024 * 1024
"""An order is refused when less than this is free: its result, faults and states need a few pages."""
_SCHEMA: Final = """
CREATE TABLE IF NOT EXISTS boots (id INTEGER PRIMARY KEY AUTOINCREMENT, at REAL NOT NULL);
CREATE TABLE IF NOT EXISTS orders (
  id INTEGER PRIMARY KEY AUTOINCREMENT, boot INTEGER NOT NULL, seq INTEGER NOT NULL, command INTEGER NOT NULL,
  body TEXT NOT NULL, accepted_at REAL NOT NULL, finished_at REAL, acknowledged_at REAL,
  code INTEGER, outcome INTEGER, result TEXT);
CREATE TABLE IF NOT EXISTS places (
  id INTEGER PRIMARY KEY AUTOINCREMENT, at REAL NOT NULL, freed INTEGER NOT NULL);
CREATE INDEX IF NOT EXISTS orders_open ON orders (id) WHERE finished_at IS NULL;
CREATE TABLE IF NOT EXISTS faults (
  id INTEGER PRIMARY KEY AUTOINCREMENT, boot INTEGER NOT NULL, at REAL NOT NULL, code INTEGER NOT NULL,
  name TEXT NOT NULL, detail TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS states (
  id INTEGER PRIMARY KEY AUTOINCREMENT, boot INTEGER NOT NULL, at REAL NOT NULL, state TEXT NOT NULL,
  event TEXT NOT NULL);
"""


class Journal:
    """One connection to the journal; each thread that writes opens its own.

    Parameters
    ----------
    path
        The database file; its folder must exist or be creatable.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._connection: sqlite3.Connection | None = None
        self._boot = 0

    def open(self) -> None:
        """Open or create.

        Raises
        ------
        ConfigError
            This file can never be a journal: of another version, not a database, in a place that is none.
        JournalError
            It cannot be written now.
        """
        if self._connection is not None:
            return
        connection: sqlite3.Connection | None = None
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            # handed from the thread that opens it to the one that uses it, never shared
            connection = sqlite3.connect(
                self._path, timeout=5.0, isolation_level=None, check_same_thread=False
            )
            connection.execute("PRAGMA journal_mode=WAL")
            connection.execute("PRAGMA synchronous=FULL")
            version = int(connection.execute("PRAGMA user_version").fetchone()[0])
            if version not in (0, SCHEMA_VERSION):
                connection.close()
                raise ConfigError(
                    self._path, None, f"journal of version {version}, this program writes {SCHEMA_VERSION}"
                )
            connection.executescript(_SCHEMA)
            if version == 0:
                connection.execute(f"PRAGMA user_version={SCHEMA_VERSION}")
            row = connection.execute("SELECT MAX(id) FROM boots").fetchone()
        except (OSError, sqlite3.Error) as error:
            if connection is not None:
                connection.close()
            if _for_now(error):
                raise JournalError(self._path, f"the journal cannot be written: {error}") from error
            raise ConfigError(self._path, None, f"the journal cannot be written: {error}") from error
        self._connection = connection
        self._boot = int(row[0] or 0)

    def close(self) -> None:
        """Close; may be called twice."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    @contextmanager
    def _write(self) -> Iterator[sqlite3.Connection]:
        connection = self._opened()
        try:
            connection.execute("BEGIN IMMEDIATE")
            yield connection
            connection.execute("COMMIT")
        except BaseException as error:
            if connection.in_transaction:  # some errors have ended it already
                connection.execute("ROLLBACK")
            if isinstance(error, sqlite3.Error):
                raise JournalError(self._path, f"the journal cannot be written: {error}") from error
            raise

    def _require_room(self) -> None:
        """Raise `JournalError` while the disk is nearly full."""
        try:
            disk = os.statvfs(self._path.parent)
        except OSError as error:
            raise JournalError(self._path, f"its disk does not answer: {error}") from error
        free = disk.f_bavail * disk.f_frsize
        if free < ROOM_BYTES:
            raise JournalError(
                self._path,
                f"only {free // 1024} KiB are free, an order needs {ROOM_BYTES // 1024} KiB for what follows",
            )

    def _opened(self) -> sqlite3.Connection:
        if self._connection is None:
            raise RuntimeError("journal used before open()")
        return self._connection

    # ---------------------------------------------------------------- boots and orders

    def boot(self) -> int:
        """Count this start; returns its number, 1..65535 for the register ``boot_id``."""
        with self._write() as connection:
            cursor = connection.execute("INSERT INTO boots (at) VALUES (?)", (time.time(),))
            self._boot = int(cursor.lastrowid or 0)
        return (self._boot - 1) % 65535 + 1

    def accept(self, order: PickOrder) -> None:
        """Make an order durable, before its acceptance is told to anybody.

        Raises
        ------
        JournalError
            It is not durable, or its result might not become so; the order must not be carried out.
        """
        self._require_room()
        with self._write() as connection:
            connection.execute(
                "INSERT INTO orders (boot, seq, command, body, accepted_at) VALUES (?, ?, ?, ?, ?)",
                (self._boot, order.request_id, int(order.command), json.dumps(asdict(order)), time.time()),
            )

    def finish(self, result: PickResult) -> None:
        """Make a result durable, before it is published. Belongs to the newest order of its sequence.

        Raises
        ------
        JournalError
            It is not durable yet; to be tried again.
        """
        with self._write() as connection:
            changed = connection.execute(
                "UPDATE orders SET finished_at = ?, code = ?, outcome = ?, result = ? WHERE id = "
                "(SELECT MAX(id) FROM orders WHERE seq = ? AND finished_at IS NULL)",
                (
                    time.time(),
                    int(result.code),
                    int(result.outcome),
                    json.dumps(asdict(result)),
                    result.request_id,
                ),
            ).rowcount
            if changed != 1:
                raise RuntimeError(f"result for sequence {result.request_id}, which is not in flight")

    def acknowledge(self, seq: int) -> None:
        """The PLC has taken the result of this sequence."""
        with self._write() as connection:
            connection.execute(
                "UPDATE orders SET acknowledged_at = ? WHERE id = "
                "(SELECT MAX(id) FROM orders WHERE seq = ?) AND acknowledged_at IS NULL",
                (time.time(), seq),
            )

    def interrupted(self) -> list[int]:
        """Sequences that were accepted and never finished, oldest first."""
        rows = self._opened().execute("SELECT seq FROM orders WHERE finished_at IS NULL ORDER BY id")
        return [int(row[0]) for row in rows]

    def last(self) -> tuple[int, PickResult | None, bool]:
        """The newest order: its sequence (0: none), its result if finished, whether the PLC took that."""
        row = (
            self._opened()
            .execute("SELECT seq, result, acknowledged_at FROM orders ORDER BY id DESC LIMIT 1")
            .fetchone()
        )
        if row is None:
            return 0, None, False
        return int(row[0]), None if row[1] is None else result_of(row[1]), row[2] is not None

    def total_picked(self) -> int:
        """Parts picked since this journal began."""
        row = self._opened().execute(
            "SELECT COUNT(*) FROM orders WHERE outcome = ? AND code = ?",
            (int(Outcome.PICKED), int(ResultCode.OK)),
        )
        return int(row.fetchone()[0])

    def counted_after(self, row: int) -> tuple[int, int, int]:
        """Finished orders after a row: parts delivered, picks that brought none, the last row counted.

        A number beyond the last row belongs to another journal: everything in this one is counted.
        """
        last = self._opened().execute("SELECT MAX(id) FROM orders WHERE finished_at IS NOT NULL").fetchone()
        newest = int(last[0] or 0)
        found = self._opened().execute(
            "SELECT COALESCE(SUM(outcome = ? AND code = ?), 0), "
            "COALESCE(SUM(outcome IN (?, ?) AND command IN (?, ?)), 0) FROM orders WHERE id > ? AND id <= ?",
            (
                int(Outcome.PICKED),
                int(ResultCode.OK),
                int(Outcome.MISSED),
                int(Outcome.ABORTED),
                int(PlcCommand.PICK),
                int(PlcCommand.PICK_AND_PLACE),
                0 if row > newest else row,
                newest,
            ),
        )
        produced, failed = found.fetchone()
        return int(produced), int(failed), newest

    # ---------------------------------------------------------------- places of the pattern

    def places_taken(self) -> int:
        """Places taken since the tray was last changed."""
        row = self._opened().execute(
            "SELECT COUNT(*) FROM places WHERE id > (SELECT COALESCE(MAX(id), 0) FROM places WHERE freed = 1)"
        )
        return int(row.fetchone()[0])

    def take_place(self) -> None:
        """The next place is taken, before the arm goes there."""
        self._place(freed=False)

    def free_places(self) -> None:
        """The tray has been changed."""
        self._place(freed=True)

    def _place(self, *, freed: bool) -> None:
        with self._write() as connection:
            connection.execute("INSERT INTO places (at, freed) VALUES (?, ?)", (time.time(), int(freed)))

    # ---------------------------------------------------------------- faults and states

    def fault(self, fault: Fault) -> None:
        """Keep a fault."""
        with self._write() as connection:
            connection.execute(
                "INSERT INTO faults (boot, at, code, name, detail) VALUES (?, ?, ?, ?, ?)",
                (self._boot, time.time(), int(fault.code), fault.code.name, fault.detail),
            )

    def fault_count(self) -> int:
        """Faults since this journal began."""
        return int(self._opened().execute("SELECT COUNT(*) FROM faults").fetchone()[0])

    def state(self, state: State, event: str) -> None:
        """Keep a change of state."""
        with self._write() as connection:
            connection.execute(
                "INSERT INTO states (boot, at, state, event) VALUES (?, ?, ?, ?)",
                (self._boot, time.time(), state.name, event),
            )


def result_of(text: str) -> PickResult:
    """A result from its journal text."""
    fields = json.loads(text)
    pose = fields.pop("pose")
    code, outcome = ResultCode(fields.pop("code")), Outcome(fields.pop("outcome"))
    return PickResult(code=code, outcome=outcome, pose=None if pose is None else ToolPose(**pose), **fields)


def _for_now(error: OSError | sqlite3.Error) -> bool:
    """True for what may be different at the next start: no room, a device that does not answer."""
    if isinstance(error, OSError):
        return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)
    primary = getattr(error, "sqlite_errorcode", 0) & 0xFF
    return primary in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_BUSY)
