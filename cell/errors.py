"""Errors a person can act on: each names the file, the place in it, and what to do."""

from __future__ import annotations

from pathlib import Path


class ConfigError(Exception):
    """A configuration, product or journal file cannot be used; exit code 78."""

    def __init__(self, path: Path, line: int | None, detail: str) -> None:
        super().__init__(f"{path}: {detail}" if line is None else f"{path}:{line}: {detail}")
        self.path = path
        self.line = line
        self.detail = detail


class CalibrationError(Exception):
    """A calibration file is missing, broken or belongs to other cameras; exit code 78."""

    def __init__(self, detail: str) -> None:
        super().__init__(detail)
        self.detail = detail


class UsageError(Exception):
    """What was asked for on the command line cannot be done; exit code 2."""

    def __init__(self, detail: str) -> None:
        super().__init__(detail)
        self.detail = detail


class JournalError(Exception):
    """The journal cannot be written now, as on a full disk. Nothing may move without it."""

    def __init__(self, path: Path, detail: str) -> None:
        super().__init__(f"{path}: {detail}; make room on its disk, or make it writable again")
        self.path = path
        self.detail = detail
