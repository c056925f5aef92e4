"""Settings of learning the belt that the engineer gives: the options of ``measure belt``, the table [belt]."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator

_Place = Annotated[float, Field(ge=-20_000, le=20_000)]
_Pixel = Annotated[float, Field(ge=-10_000, le=100_000)]


class GivenBelt(BaseModel):
    """Width, ends, region or direction of the belt, where given; by default everything is found in the depth maps."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    width_mm: Annotated[float, Field(ge=50, le=10_000)] | None = None
    """Width of the belt along its surface, as ordered; an end that is not seen follows from it."""
    across_mm: tuple[_Place, _Place] | None = None
    """The belt's ends in x of the belt frame, whose origin is where the core's optical axis meets the belt."""
    region_px: tuple[tuple[_Pixel, _Pixel], ...] | None = None
    """Corners u, v of a polygon around the belt, in the core camera's undistorted image, which preview.png shows."""
    travel_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    """Direction of travel of a flat belt without edges in view, in the core camera's undistorted image: its angle to
    the image's columns, clockwise."""

    @model_validator(mode="after")
    def _check(self) -> GivenBelt:
        if self.across_mm is not None and self.across_mm[0] >= self.across_mm[1]:
            raise ValueError(
                f"across_mm = {list(self.across_mm)}: give the lower end first, both in mm of the belt frame"
            )
        if self.across_mm is not None and self.width_mm is not None:
            raise ValueError("across_mm and width_mm: give one of them")
        if self.region_px is not None and len(self.region_px) < 3:
            raise ValueError(
                f"region_px has {len(self.region_px)} corners: a polygon needs at least 3 pairs u, v"
            )
        return self


NOTHING_GIVEN = GivenBelt()
"""Everything is found in the depth maps."""
