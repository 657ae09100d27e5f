"""The last configuration that was good, kept beside the journal, for a start with one that is not.

A cell whose configuration somebody has broken refuses to start, and says where: that is what the person who
changed it expects. A service that must not stand for that can be told to go on with the last good one
(``mikado run CONFIG --last-good FILE``); it then says so in its log, and by an alarm, until it is put right.
"""

from __future__ import annotations

import os
from pathlib import Path

from cell import config as configuration
from cell import wiring
from cell.config import CellConfig
from cell.errors import CalibrationError, ConfigError
from cell.logs import logger

log = logger("daemon")


def usable(path: Path, last_good: Path | None) -> tuple[CellConfig, str | None]:
    """The configuration to start with, and why it is not the one of ``path`` (None: it is).

    Raises
    ------
    ConfigError, CalibrationError
        It cannot be used, and there is no other: what is wrong with the one of ``path``.
    """
    try:
        config = checked(path)
    except (ConfigError, CalibrationError) as error:
        if last_good is None or not last_good.is_file():
            raise
        log.error(
            "configuration_refused",
            detail=str(error),
            running_with=str(last_good),
            action=f"correct it, try `mikado check {path}`, restart the service",
        )
        return checked(last_good, home=path.resolve().parent), str(error)
    if last_good is not None:
        try:
            keep(path, last_good)
        except ConfigError as error:
            log.warning("last_good_not_kept", detail=str(error))
    return config, None


def checked(path: Path, home: Path | None = None) -> CellConfig:
    """A configuration that holds as far as can be known without a device; see `usable` for what it raises."""
    config = configuration.load(path, home)
    wiring.check(config, str(path))
    return config


def keep(path: Path, last_good: Path) -> None:
    """Copy a good configuration; the copy is whole or the one before.

    Raises
    ------
    ConfigError
        The copy cannot be written.
    """
    partial = last_good.with_name(last_good.name + ".part")
    try:
        last_good.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("wb") as file:
            file.write(path.read_bytes())
            file.flush()
            os.fsync(file.fileno())
        partial.replace(last_good)
    except OSError as error:
        raise ConfigError(last_good, None, f"the good configuration cannot be kept there: {error}") from error
