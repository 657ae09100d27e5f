"""How a cell is run: strategy, places, recovery, modes, planned time. A section of the configuration."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, NonNegativeInt, PositiveFloat, PositiveInt, model_validator

from drivers.settings import Settings, Six

Hour = Annotated[str, Field(pattern=r"^([01]\d|2[0-3]):[0-5]\d$")]


class StrategyConfig(Settings):
    """Which part next, and when to look for it."""

    avoid_looks: NonNegativeInt = Field(
        default=5, description="a part on which a grip failed comes last for this many looks"
    )
    avoid_radius_m: PositiveFloat = Field(
        default=0.010, description="a part with its middle this near to the failed one is taken for it"
    )
    look_while_placing: bool = Field(
        default=False,
        description="take the next picture on the way to the box; detection overlaps the motion",
    )
    clear_q_rad: Six | None = Field(
        default=None,
        description="joints on the way to the box from which on the arm is out of both pictures; needed for "
        "look_while_placing",
    )
    prepared_max_age_s: PositiveFloat = Field(
        default=10.0, description="a picture taken while placing is not used when it is older than this"
    )

    @model_validator(mode="after")
    def _clear(self) -> Self:
        if self.look_while_placing and self.clear_q_rad is None:
            raise ValueError(
                "look_while_placing needs clear_q_rad: joints at which the arm is out of both pictures; "
                "give drop_q_rad's where the box itself is out of view"
            )
        return self


class GridConfig(Settings):
    """Places in rows and columns, counted from the drop position along the base frame's x and y."""

    rows: PositiveInt = 1
    columns: PositiveInt = 1
    row_pitch_m: tuple[float, float] = Field(default=(0.0, 0.0), description="x, y from a row to the next")
    column_pitch_m: tuple[float, float] = Field(
        default=(0.0, 0.0), description="x, y from a column to the next"
    )
    when_full: Literal["report", "wrap"] = Field(
        default="report",
        description="report: orders end with 15 until command 10, choice 5; wrap: start anew",
    )

    @model_validator(mode="after")
    def _pitch(self) -> Self:
        for count, pitch, key in (
            (self.rows, self.row_pitch_m, "row_pitch_m"),
            (self.columns, self.column_pitch_m, "column_pitch_m"),
        ):
            if count > 1 and pitch == (0.0, 0.0):
                raise ValueError(f"{key} is 0, but there are {count} of them: all would lie in one place")
        return self


class RecoveryConfig(Settings):
    """What happens after something went wrong."""

    ask_after_failed_grips: NonNegativeInt = Field(
        default=0,
        description="so many orders in a row without a part and the cell is held until a person has chosen "
        "(command 10: 1 retry, 2 skip, 3 count as picked, 4 stop; a reset is skip); 0: never",
    )
    reconnect_first_s: PositiveFloat = Field(
        default=1.0, description="pause before a lost device is opened again; doubles each time"
    )
    reconnect_longest_s: PositiveFloat = 30.0
    reconnect_tries: NonNegativeInt = Field(default=20, description="then only a reset tries again; 0: never")


class ModesConfig(Settings):
    """Modes other than production."""

    hover_height_m: PositiveFloat | None = Field(
        default=None, description="dry run: height over the grasp; default: workspace.approach_height_m"
    )
    maintenance_speed_percent: Annotated[int, Field(ge=1, le=100)] = 25


class PlannedConfig(Settings):
    """Planned production time, every day, local time. Without it no OEE is shown."""

    begin: Hour
    end: Hour
    ideal_cycle_s: PositiveFloat = Field(description="duration of a pick when nothing is wrong")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.begin >= self.end:
            raise ValueError(f"begin {self.begin} is not before end {self.end}")
        return self


class OperationConfig(Settings):
    """How the cell is run; every key may be left out."""

    strategy: StrategyConfig = StrategyConfig()
    grid: GridConfig = GridConfig()
    recovery: RecoveryConfig = RecoveryConfig()
    modes: ModesConfig = ModesConfig()
    planned: PlannedConfig | None = None
