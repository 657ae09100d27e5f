"""A configuration or product file of which a command changes values: checked whole before it is written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from cell import yamledit
from cell.errors import ConfigError, UsageError

Loaded = TypeVar("Loaded")


def put(path: Path, section: str, values: Mapping[str, str], load: Callable[[Path], Loaded]) -> Loaded:
    """Change keys of a section; the old file is kept beside as ``.old``. What the file has become.

    Raises
    ------
    ConfigError
        It would no longer be what ``load`` reads; nothing is written.
    UsageError
        It cannot be written.
    """
    text = yamledit.replaced(path, section, values)
    beside = path.with_name(path.name + ".new")
    try:
        beside.write_text(text, encoding="utf-8")
        try:
            load(beside)
        except ConfigError as error:
            raise ConfigError(path, None, f"not changed: {error.detail}") from error
        else:
            path.with_name(path.name + ".old").write_bytes(path.read_bytes())
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error
    return load(path)
