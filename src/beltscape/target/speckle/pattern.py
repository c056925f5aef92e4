"""The projector's speckle pattern: random dots with a minimum distance, and 16 markers."""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import floor
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator

from beltscape.core.errors import SettingsError
from beltscape.target.speckle.darts import throw_darts
from beltscape.target.speckle.packing import AUTOMATIC_SHARE, MAX_SHARE, find_largest_d_min, saturated_count

PRESETS = {"paper": 25_000, "fine": 50_000, "dense": 100_000}
"""Number of dots by preset; ``paper`` is the paper's pattern."""

MARKERS = 4
"""Rows and columns of markers."""

MARKER_RATIO = 10
"""Ratio of a marker's radius to a dot's."""

RADIUS_OF_D_MIN = 0.34
"""Default ratio of dot radius to d_min; dots then cover about a quarter of the plane."""

MIN_RADIUS_PX = 0.3
"""Finer dots only change the grey level of one pixel."""


def _parse_color(text: str) -> str:
    if not re.fullmatch(r"#[0-9a-fA-F]{6}", text):
        raise ValueError("a colour is written #RRGGBB, as #FFD700")
    return text.upper()


Side = Annotated[int, Field(ge=64, le=8192)]
Share = Annotated[float, Field(ge=0, le=1)]
Length = Annotated[float, Field(gt=0, le=8192)]
Color = Annotated[str, AfterValidator(_parse_color)]


class PatternSettings(BaseModel):
    """Settings of a pattern; None is chosen to suit the others."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    size_px: tuple[Side, Side] = (1920, 1200)
    seed: int = Field(default=0, ge=0, lt=2**63)
    count: int = Field(default=PRESETS["paper"], ge=1, le=400_000)
    d_min_px: Length | None = None
    radius_px: Annotated[float, Field(ge=MIN_RADIUS_PX, le=512)] | None = None
    grey: tuple[Share, Share] = (1.0, 1.0)
    dot_color: Color = "#FFD700"
    background: Color = "#0A0A0A"
    marker_color: Color = "#FF0000"

    @field_validator("grey")
    @classmethod
    def _check_order(cls, grey: tuple[float, float]) -> tuple[float, float]:
        if grey[0] > grey[1]:
            raise ValueError("the first level must be the smaller one")
        return grey


@dataclass(frozen=True, slots=True)
class Marker:
    """One of the markers at the centres of a 4×4 grid of blocks."""

    row: int
    col: int
    center_px: tuple[float, float]
    radius_px: float


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """A pattern to project. Pixel (0, 0) is the centre of the top-left pixel."""

    settings: PatternSettings
    """Resolved: no value is None."""
    dots: NDArray[np.float64]
    """(N, 4) x, y, radius in px, level 0..1 between background and dot colour; in the order of acceptance."""
    markers: tuple[Marker, ...]
    """Row by row from the top left."""

    @property
    def size_px(self) -> tuple[int, int]:
        """Return width and height."""
        return self.settings.size_px

    def keep_out(self) -> NDArray[np.float64]:
        """Return (16, 3) x, y, radius of the discs about the markers that contain no dot's centre, px."""
        return _keep_out_discs(self.settings, self.markers)


def make_pattern(settings: PatternSettings) -> Pattern:
    """Generate the dots of a pattern (Eqs. 4-6); the same settings give the same pattern.

    Raises
    ------
    SettingsError
        If the dots do not fit; the message names settings that do.

    References
    ----------
    Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, section 2.1.
    """
    settings = resolve_settings(settings)
    markers = make_markers(settings)
    # levels have a separate random stream, so that the grey range does not affect the positions
    position_rng, level_rng = (np.random.default_rng((settings.seed, stream)) for stream in range(2))
    d_min = _resolved_length(settings.d_min_px)
    xy = throw_darts(
        settings.size_px, settings.count, d_min, _keep_out_discs(settings, markers), position_rng
    )
    if len(xy) < settings.count:
        raise SettingsError(_describe_excess(settings, d_min, len(xy)))
    low, high = settings.grey
    level = np.round(low + (high - low) * level_rng.random(len(xy)), 3)
    dots = np.column_stack([xy, np.full(len(xy), settings.radius_px), level])
    return Pattern(settings, dots, markers)


def make_markers(settings: PatternSettings) -> tuple[Marker, ...]:
    """Return the markers of resolved settings (Eq. 6)."""
    width, height = settings.size_px
    radius = _marker_radius(_resolved_length(settings.radius_px))
    return tuple(
        Marker(row, col, (width / MARKERS * (col + 0.5) - 0.5, height / MARKERS * (row + 0.5) - 0.5), radius)
        for row in range(MARKERS)
        for col in range(MARKERS)
    )


def resolve_settings(settings: PatternSettings) -> PatternSettings:
    """Return the settings with d_min and radius chosen where they are None, or raise SettingsError."""
    d_min = settings.d_min_px or _choose_d_min(settings)
    radius = _choose_radius(settings, d_min)
    max_radius = _max_dot_radius(settings)
    if radius < MIN_RADIUS_PX:
        max_count = _max_count(settings, MIN_RADIUS_PX / RADIUS_OF_D_MIN, AUTOMATIC_SHARE)
        raise SettingsError(
            f"{settings.count} dots on {_format_size(settings)} would be finer than a radius of "
            f"{MIN_RADIUS_PX:g} px; give at most {max_count}"
        )
    if d_min < 2 * radius:
        raise SettingsError(_describe_overlap(settings, d_min, radius))
    if radius > max_radius:
        raise SettingsError(
            f"dots of radius {radius:g} px have markers of {_marker_radius(radius):g} px, too large for their blocks "
            f"on {_format_size(settings)}; give a dot radius up to {_round_down(max_radius):g} px"
        )
    if settings.count > _max_count(settings, d_min):
        raise SettingsError(_describe_excess(settings, d_min, _max_count(settings, d_min)))
    return settings.model_copy(update={"d_min_px": d_min, "radius_px": radius})


def _max_dot_radius(settings: PatternSettings) -> float:
    """Return the radius of a dot whose marker is half as wide as its block."""
    return min(settings.size_px) / MARKERS / 4 / MARKER_RATIO


def _choose_radius(settings: PatternSettings, d_min_px: float) -> float:
    """Return the given radius, or one in proportion to d_min that is not too wide for the markers."""
    return settings.radius_px or min(
        round(RADIUS_OF_D_MIN * d_min_px, 2), _round_down(_max_dot_radius(settings))
    )


def _marker_radius(radius_px: float) -> float:
    return round(MARKER_RATIO * radius_px, 6)


def _clearance(radius_px: float, d_min_px: float) -> float:
    """Return the distance of a dot's centre from a marker's: rims are as far apart as those of two dots."""
    return _marker_radius(radius_px) + d_min_px - radius_px


def _keep_out_discs(settings: PatternSettings, markers: tuple[Marker, ...]) -> NDArray[np.float64]:
    clearance = _clearance(_resolved_length(settings.radius_px), _resolved_length(settings.d_min_px))
    return np.array([(*marker.center_px, clearance) for marker in markers])


def _max_count(settings: PatternSettings, d_min_px: float, share: float = MAX_SHARE) -> int:
    """Return the number of dots that fit at this d_min, as a share of those that fill the plane."""
    clearance = _clearance(_choose_radius(settings, d_min_px), d_min_px)
    return floor(share * saturated_count(settings.size_px, d_min_px, clearance, MARKERS**2))


def _choose_d_min(settings: PatternSettings) -> float:
    """Return the largest d_min that leaves enough free area for the count."""
    return find_largest_d_min(lambda d: _max_count(settings, d, AUTOMATIC_SHARE), settings.count)


def _describe_excess(settings: PatternSettings, d_min_px: float, most: int) -> str:
    largest = find_largest_d_min(lambda d: _max_count(settings, d), settings.count)
    least = 2 * (settings.radius_px or MIN_RADIUS_PX / RADIUS_OF_D_MIN / 2)
    fix = f", or d_min up to {largest:g} px" if largest >= least else ""
    size = _format_size(settings)
    return f"{settings.count} dots do not fit {size} at d_min {d_min_px:g} px; at most {most} do{fix}"


def _describe_overlap(settings: PatternSettings, d_min_px: float, radius_px: float) -> str:
    if settings.d_min_px is not None:
        return (
            f"d_min {d_min_px:g} px lets dots of radius {radius_px:g} px overlap; "
            f"give d_min of at least {2 * radius_px:g} px, or a radius up to {_round_down(d_min_px / 2):g} px"
        )
    return (
        f"{settings.count} dots of radius {radius_px:g} px overlap on {_format_size(settings)}; "
        f"give at most {_max_count(settings, 2 * radius_px, AUTOMATIC_SHARE)} dots, or no radius"
    )


def _round_down(value: float) -> float:
    return floor(value * 100) / 100


def _format_size(settings: PatternSettings) -> str:
    return f"{settings.size_px[0]}×{settings.size_px[1]} px"


def _resolved_length(value: float | None) -> float:
    """Return a length of resolved settings."""
    if value is None:
        raise SettingsError("the pattern's lengths are not chosen yet; resolve its settings first")
    return value
