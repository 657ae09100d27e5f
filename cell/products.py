"""What the configuration says of one product, and whether two can be told apart in one heap."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Final, Self

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from drivers.settings import Settings
from vision.types import ColourRange, PartModel, Tuning

Degrees = Annotated[float, Field(ge=0, le=360)]
Share = Annotated[float, Field(ge=0, le=1)]
Grey = Annotated[int, Field(ge=0, le=255)]

TOLD_BY_WIDTH: Final = 1.4
"""Of two parts, one this many times as thick as the other is refused as the other by its width."""


class ColourConfig(Settings):
    """Colours that count as this product in the left picture. See `vision.types.ColourRange`."""

    hue_deg: tuple[Degrees, Degrees] = Field(
        default=(0.0, 360.0),
        description="from, to: red 0, yellow 60, green 120, blue 240; from > to goes over 0",
    )
    saturation: tuple[Share, Share] = Field(default=(0.0, 1.0), description="0 grey, 1 pure colour")
    value: tuple[Share, Share] = Field(default=(0.0, 1.0), description="0 black, 1 as bright as can be")

    @model_validator(mode="after")
    def _some_colour(self) -> Self:
        if self.hue_deg[0] == self.hue_deg[1]:
            raise ValueError(f"hue_deg is empty: from and to are both {self.hue_deg[0]}")
        for key, (low, high) in (("saturation", self.saturation), ("value", self.value)):
            if low >= high:
                raise ValueError(f"{key} is empty: min {low} is not below max {high}")
        if self.range() == ColourRange():
            raise ValueError(
                "every colour would count; give hue_deg, saturation or value, or leave colour out"
            )
        return self

    def apart_from(self, other: ColourConfig) -> bool:
        """Whether no colour counts for both."""
        if any(
            max(mine[0], its[0]) > min(mine[1], its[1])
            for mine, its in ((self.saturation, other.saturation), (self.value, other.value))
        ):
            return True
        return not any(
            _turns_into(a, b) for a, b in ((self.hue_deg, other.hue_deg), (other.hue_deg, self.hue_deg))
        )

    @classmethod
    def of(cls, colours: ColourRange | None) -> ColourConfig | None:
        """The same from the detector's record; None stays none."""
        if colours is None:
            return None
        return cls(hue_deg=colours.hue_deg, saturation=colours.saturation, value=colours.value)

    def range(self) -> ColourRange:
        """The colours as the detector takes them."""
        return ColourRange(hue_deg=self.hue_deg, saturation=self.saturation, value=self.value)


def _turns_into(one_deg: tuple[float, float], other_deg: tuple[float, float]) -> bool:
    """Whether the first of a range of hues lies in another one."""
    low, high = other_deg
    first = one_deg[0]
    return low <= first <= high if low <= high else first >= low or first <= high


class GraspConfig(Settings):
    """Where along a part it is gripped, and the way there and away. Left out: the middle, straight down."""

    from_middle_m: NonNegativeFloat = Field(
        default=0.0, description="best place, from the part's middle; either side counts alike"
    )
    slack_m: NonNegativeFloat | None = Field(
        default=None, description="how far from there the jaws may look for room (default: 0.4 of length_m)"
    )
    approach_height_m: PositiveFloat | None = Field(
        default=None, description="instead of workspace.approach_height_m, for this part"
    )
    retreat_height_m: PositiveFloat | None = Field(
        default=None, description="the part is lifted at least so high before the arm travels"
    )
    free_rotation_rad: float = Field(
        default=0.0,
        ge=0.0,
        le=0.8,
        description="where the jaws have no room straight down, the hand may lean so far about the part's "
        "axis, to either side; it comes and goes along its own direction",
    )


class PartConfig(Settings):
    """One product. A straight stick is given by its length and diameter."""

    code: PositiveInt = Field(le=65535, description="what the PLC writes as recipe")
    name: str
    length_m: PositiveFloat
    length_tolerance_m: PositiveFloat
    diameter_m: PositiveFloat
    colour: ColourConfig | None = Field(
        default=None, description="where parts of one size differ in colour; needs a left camera in colour"
    )

    band: tuple[Grey, Grey] | None = Field(
        default=None, description="published method: grey values that count as this part (`product teach`)"
    )
    thinning_end_m: float = Field(
        default=0.0,
        description="published method: what thinning takes from each end, or adds (`product teach`)",
    )

    grasp: GraspConfig | None = Field(default=None, description="where it is gripped (`product grasp`)")

    @model_validator(mode="after")
    def _plausible(self) -> Self:
        if self.grasp is not None and self.grasp.from_middle_m >= self.length_m / 2:
            raise ValueError(
                f"grasp.from_middle_m {self.grasp.from_middle_m} is beyond the end: half of length_m is "
                f"{self.length_m / 2}"
            )
        if self.length_m > 2.0:
            raise ValueError(f"length_m {self.length_m} is over 2 m: lengths are in metres, not millimetres")
        if self.diameter_m >= self.length_m:
            raise ValueError(f"diameter_m {self.diameter_m} is not below length_m {self.length_m}")
        if abs(self.thinning_end_m) >= self.length_m / 4:
            raise ValueError(f"thinning_end_m {self.thinning_end_m}: over a quarter of length_m")
        if self.band is not None and self.band[0] >= self.band[1]:
            raise ValueError(f"band is empty: min {self.band[0]} is not below max {self.band[1]}")
        if self.length_tolerance_m >= self.length_m / 2:
            raise ValueError(f"length_tolerance_m {self.length_tolerance_m} is over half of length_m")
        return self

    def apart_from(self, other: PartConfig) -> bool:
        """Whether the detector can tell the two by length, by thickness or by colour."""
        if abs(self.length_m - other.length_m) > self.length_tolerance_m + other.length_tolerance_m:
            return True
        thin, thick = sorted((self.diameter_m, other.diameter_m))
        if thick > TOLD_BY_WIDTH * thin:
            return True
        return self.colour is not None and other.colour is not None and self.colour.apart_from(other.colour)

    def model(self) -> PartModel:
        """The product as the detector knows it."""
        return PartModel(
            code=self.code,
            name=self.name,
            length_m=self.length_m,
            length_tolerance_m=self.length_tolerance_m,
            diameter_m=self.diameter_m,
            colour=None if self.colour is None else self.colour.range(),
            thinning_end_m=self.thinning_end_m,
        )

    def tuned(self, tuning: Tuning) -> Tuning:
        """The gates for a look at this product: its own band where the published method has none."""
        if tuning.method == "published" and tuning.band is None:
            return replace(tuning, band=self.band)
        return tuning
