"""What was printed, and how long the printed bar really is: the file beside a calibration board.

Printers scale. A board whose squares are two hundredths too large calibrates just as well, every residual
stays as it is, and every distance the cell measures is wrong by two hundredths. Only a ruler shows it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal, Self

import yaml
from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from cell import yamlfile
from cell.errors import UsageError
from drivers.settings import Settings
from vision.boards import Board

BELIEVED: Final = 0.06
"""A bar this share too long or too short is a slip of the ruler or a scaled page, not a printer."""


class BoardConfig(Settings):
    """A calibration board: lengths as they were meant, and ``measured_bar_m``, the ruler's word."""

    kind: Literal["charuco", "chessboard"]
    columns: PositiveInt = Field(description="squares, not inner corners")
    rows: PositiveInt
    pitch_m: PositiveFloat = Field(description="side of a square")
    marker_m: PositiveFloat | None = Field(default=None, description="side of a marker (ChArUco)")
    dictionary: str | None = Field(default=None, description="marker family, e.g. DICT_4X4_100 (ChArUco)")
    legacy: bool = Field(default=False, description="layout of OpenCV before 4.6, of boards with even rows")
    bar_m: PositiveFloat | None = Field(default=None, description="the bar printed beside the board")
    measured_bar_m: PositiveFloat | None = Field(
        default=None, description="the same, measured on the print: corrects pitch and markers"
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.kind == "charuco" and (self.marker_m is None or self.dictionary is None):
            raise ValueError("a ChArUco board needs marker_m and dictionary")
        if self.measured_bar_m is not None and self.bar_m is None:
            raise ValueError("measured_bar_m without bar_m: how long should the bar be?")
        if abs(self.scale - 1.0) > BELIEVED:
            raise ValueError(
                f"the bar should be {1e3 * (self.bar_m or 0):g} mm long and measures "
                f"{1e3 * (self.measured_bar_m or 0):g} mm: print again at 100 % (not 'fit to page'), "
                "or measure again; millimetres on the command line, metres in the file"
            )
        self.board()
        return self

    @property
    def scale(self) -> float:
        """Measured over printed; 1 where nothing was measured."""
        if self.measured_bar_m is None or self.bar_m is None:
            return 1.0
        return self.measured_bar_m / self.bar_m

    @property
    def measured(self) -> bool:
        """Whether a ruler was laid beside the print."""
        return self.measured_bar_m is not None

    def board(self) -> Board:
        """The board as it really is."""
        return Board(
            kind=self.kind,
            columns=self.columns,
            rows=self.rows,
            pitch_m=self.pitch_m * self.scale,
            marker_m=(self.marker_m or 0.0) * self.scale,
            dictionary=self.dictionary or "",
            legacy=self.legacy,
        )

    def words(self) -> str:
        """One line for people."""
        name = "ChArUco board" if self.kind == "charuco" else "chessboard"
        what = f"{self.columns} x {self.rows} squares of {1e3 * self.pitch_m:g} mm"
        if self.kind == "charuco":
            what += f", markers {1e3 * (self.marker_m or 0):g} mm, {self.dictionary}"
        return f"{name}, {what}"


def load(path: Path) -> BoardConfig:
    """Read a board file. Raises `ConfigError` with file, line and key."""
    return yamlfile.load(path, BoardConfig)


def save(path: Path, board: BoardConfig) -> None:
    """Write a board file. Raises `UsageError` when it cannot be written."""
    values = {key: value for key, value in board.model_dump(mode="json").items() if value is not None}
    text = f"# {board.words()}. Metres. Written by `mikado calibrate board`.\n" + yaml.safe_dump(
        values, sort_keys=False
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error
