"""The projector's speckle pattern: random dots with a minimum distance, and 16 markers.

Darts are thrown, random points with a minimum distance between each other, up to a share of the capacity of the
plane.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from math import floor, pi, sqrt
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator

from beltscape.core.errors import SettingsError

GRAINS = 1000
"""Positions are whole thousandths of a pixel, so that distances are compared in exact integers."""

RASTER_CELLS = 8
"""Cells of the raster of free positions per d_min."""

MAX_EMPTY_ROUNDS = 20
"""Rounds of at least MIN_ROUND darts without an accepted one after which the plane counts as full."""

MIN_ROUND, MAX_ROUND = 16384, 65536
"""Least and largest number of darts thrown at once, which bound the calls and the memory."""


def throw_darts(
    size_px: tuple[int, int],
    count: int,
    d_min_px: float,
    keep_out: NDArray[np.float64],
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Return up to ``count`` random points, each accepted only if farther than ``d_min_px`` from those before.

    Only darts that are certainly rejected (into raster cells wholly covered by one accepted dot) are omitted, so that
    accepted points are distributed as if every dart had been thrown at the whole plane. Fewer than ``count``
    points are returned when the plane is full.

    Parameters
    ----------
    size_px
        Width and height; points lie in [-0.5, W - 0.5] × [-0.5, H - 0.5].
    keep_out
        (K, 3) x, y, radius of discs, px, that must contain no point.

    Returns
    -------
    (N, 2) float64 points in the order of acceptance, px, N ≤ count.

    References
    ----------
    Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, Eqs. 4-5.
    """
    plane = _Plane(size_px, d_min_px, np.asarray(keep_out, dtype=np.float64))
    empty_rounds = 0
    while plane.count < count and empty_rounds < MAX_EMPTY_ROUNDS:
        missing = count - plane.count
        darts = plane.draw_darts(rng, min(max(2 * missing, MIN_ROUND), MAX_ROUND))
        if darts.size == 0:
            break
        accepted = plane.reject_close(darts)[: plane.max_hits]
        accepted = accepted[_resolve_conflicts(accepted, plane.limit)][:missing]
        plane.add(accepted)
        empty_rounds = 0 if accepted.size else empty_rounds + 1
    return (plane.points[: plane.count] - GRAINS / 2).astype(np.float64) / GRAINS


class _Plane:
    """The accepted points in grains from the image's corner, a grid for neighbours, a raster of free positions."""

    def __init__(self, size_px: tuple[int, int], d_min_px: float, keep_out: NDArray[np.float64]) -> None:
        self.size = np.array(size_px) * GRAINS
        d = d_min_px * GRAINS
        self.limit = floor(d * d + 1e-3)  # squared distances up to this are too close; ties are rejected
        self.max_hits = 64 + int(
            2 * self.size.prod() / self.limit
        )  # more at once would mostly conflict with each other
        self.keep_out = np.column_stack([keep_out[:, :2] + 0.5, keep_out[:, 2]]) * GRAINS
        self.cell = d / sqrt(2)  # at most one point in a cell
        columns, rows = (np.floor(self.size / self.cell) + 5).astype(int)
        self.index = np.full((rows, columns), -1, dtype=np.int64)
        self.fine = d / RASTER_CELLS
        width, height = np.ceil(self.size / self.fine).astype(int)
        self.free = np.ones((height, width), dtype=bool)
        self.points = np.full((1, 2), -(10**9), dtype=np.int64)  # the last row represents an empty cell
        self.count = 0

    def draw_darts(self, rng: np.random.Generator, count: int) -> NDArray[np.int64]:
        """Return (count, 2) darts, uniform over the free raster cells; none when there is no free cell."""
        cells = np.flatnonzero(self.free)
        if cells.size == 0:
            return np.empty((0, 2), dtype=np.int64)
        row, column = np.divmod(cells[rng.integers(cells.size, size=count)], self.free.shape[1])
        xy = (np.stack([column, row], axis=-1) + rng.random((count, 2))) * self.fine
        return np.rint(xy[(xy <= self.size).all(axis=1)]).astype(np.int64)

    def reject_close(self, darts: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the darts far enough from every accepted point and outside the keep-out discs."""
        for x, y, radius in self.keep_out:
            is_far = (darts[:, 0] - x) ** 2 + (darts[:, 1] - y) ** 2 > radius * radius
            darts = darts[is_far]
        column, row = self._cells(darts)
        columns, index = self.index.shape[1], self.index.ravel()
        place, (x, y) = row * columns + column, np.ascontiguousarray(darts.T)
        points_x, points_y = np.ascontiguousarray(self.points.T)
        # coordinate by coordinate, because sums over an axis of two are slow
        for dy, dx in _NEIGHBOURS:
            neighbour = index[place + (dy * columns + dx)]
            is_far = (x - points_x[neighbour]) ** 2 + (y - points_y[neighbour]) ** 2 > self.limit
            x, y, place = x[is_far], y[is_far], place[is_far]
        return np.stack([x, y], axis=-1)

    def add(self, points: NDArray[np.int64]) -> None:
        """Accept points and mark the raster cells that they cover."""
        column, row = self._cells(points)
        self.index[row, column] = self.count + np.arange(len(points))
        self.points = np.concatenate([self.points[:-1], points, self.points[-1:]])
        self.count += len(points)
        cells = np.floor(points / self.fine).astype(np.int64)
        height, width = self.free.shape
        for dx, dy in _COVERED:
            x, y = cells[:, 0] + dx, cells[:, 1] + dy
            inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
            self.free[y[inside], x[inside]] = False

    def _cells(self, points: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        column, row = np.floor(points.T / self.cell).astype(np.int64) + 2
        return column, row


_NEIGHBOURS = sorted(
    ((dy, dx) for dy in range(-2, 3) for dx in range(-2, 3) if abs(dx) + abs(dy) < 4),
    key=lambda offset: offset[0] ** 2 + offset[1] ** 2,
)
"""Grid cells that can contain a point within d_min, the nearest first."""

_COVERED = [
    (dx, dy)
    for dy in range(-RASTER_CELLS, RASTER_CELLS + 1)
    for dx in range(-RASTER_CELLS, RASTER_CELLS + 1)
    if (abs(dx) + 1) ** 2 + (abs(dy) + 1) ** 2 <= RASTER_CELLS**2
]
"""Raster cells that a dot covers wholly, wherever it lies in its own cell."""


def _resolve_conflicts(darts: NDArray[np.int64], limit: int) -> NDArray[np.bool_]:
    """Return which darts of one round are accepted when each is compared with all accepted before it."""
    from scipy.spatial import KDTree

    is_accepted = np.ones(len(darts), dtype=bool)
    if len(darts) < 2:
        return is_accepted
    pairs = KDTree(darts).query_pairs(sqrt(limit) + 1, output_type="ndarray")  # earlier, later
    pairs = pairs[((darts[pairs[:, 0]] - darts[pairs[:, 1]]) ** 2).sum(axis=1) <= limit]
    is_decided = is_accepted.copy()
    while pairs.size:
        is_decided[pairs[:, 1]] = (
            False  # remaining: darts without an undecided earlier neighbour; they are accepted
        )
        rejected = pairs[is_decided[pairs[:, 0]], 1]
        is_accepted[rejected] = False
        pairs = pairs[~is_decided[pairs[:, 0]] & is_accepted[pairs[:, 0]] & is_accepted[pairs[:, 1]]]
        is_decided[:] = is_accepted
    return is_accepted


SATURATED_SHARE = 0.5470735
"""Area share of discs of diameter d_min placed at random until none fits: Zhang & Torquato, Phys. Rev. E 88,
053312 (2013), doi:10.1103/PhysRevE.88.053312.
"""

MAX_SHARE = 0.97
"""Maximum share of the saturated number; filling the last gaps would take too long."""

AUTOMATIC_SHARE = 0.95
"""Share of the saturated number for an automatic d_min."""

BORDER_D_MIN = 0.45
"""Centres may lie on the border: the plane acts as if larger by this many d_min (measured); half at discs."""


def saturated_count(size_px: tuple[int, int], d_min_px: float, keep_out_px: float, discs: int) -> float:
    """Return the saturated number of dots in W × H px with ``discs`` keep-out discs; 0 where these fill the plane."""
    width, height = size_px
    radius = max(keep_out_px - BORDER_D_MIN * d_min_px / 2, 0)
    area = (width + BORDER_D_MIN * d_min_px) * (
        height + BORDER_D_MIN * d_min_px
    ) - discs * pi * radius * radius
    return max(area, 0) * SATURATED_SHARE / (pi / 4 * d_min_px * d_min_px)


def find_largest_d_min(saturated: Callable[[float], float], count: float) -> float:
    """Return the largest d_min, in steps of 0.01 px, for which ``saturated(d_min)`` is at least ``count``.

    ``saturated`` must not increase with d_min. 0.0 when 0.01 px is too large.
    """
    step, low, high = 0.01, 0, 1
    while saturated(high * step) >= count:
        high *= 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if saturated(middle * step) >= count else (low, middle)
    return round(low * step, 2)


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
