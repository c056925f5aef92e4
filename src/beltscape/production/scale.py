"""Comparison with a belt scale: what its counter weighed against our volume, as bulk density, moisture and trend."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltscape.production.settings import ProductSettings, ScaleSettings
from beltscape.production.sums import ProductionSums

_UNIFORM = 1 / math.sqrt(12)
"""σ of a value that lies anywhere in an interval of length 1 (GUM 4.3.7)."""
_DISAGREEMENT = 3.0
"""σ from which a difference is reported: one sound comparison in 370 exceeds it by chance."""
_MOST_MISSING = 0.2
"""Share of belt without a measurement above which nothing is compared. Chosen: what lay there is a guess."""
_DAY_NS = 86_400 * 10**9
"""Nanoseconds of a day."""


@dataclass(frozen=True, slots=True)
class ScaleReading:
    """The counter of a belt scale at one instant."""

    wall_ns: int
    """System clock, ns since 1970."""
    kg: float
    source: str
    """Where it comes from: "csv", "modbus" or "page"."""
    by: str = ""
    """Name of the user who typed it."""


@dataclass(frozen=True, slots=True)
class Weighing:
    """Mass that the scale weighed between two instants."""

    kg: float
    """NaN where it is not known."""
    sigma_kg: float
    """One standard deviation."""
    reason: str = ""
    """Why it is not known, in a few words; empty where it is."""


@dataclass(frozen=True, slots=True)
class WeighedVolume:
    """A weighing against the volume of the same time."""

    weighing: Weighing
    density_kg_m3: float
    """Weighed mass over measured volume; NaN where either is not known."""
    sigma_kg_m3: float
    moisture_percent: float
    """Share of water if the whole change of the density is water; NaN where no moisture is known. A hint."""
    moisture_sigma_percent: float
    deviation_kg: float
    """Weighed mass less the mass by volume and known density; NaN without one."""
    deviation_sigma_kg: float
    reason: str = ""
    """Why nothing is compared, in a few words; empty where it is."""

    @property
    def disagrees(self) -> bool:
        """Return whether scale and known density disagree by more than their σ explain."""
        return abs(self.deviation_kg) > _DISAGREEMENT * self.deviation_sigma_kg


@dataclass(frozen=True, slots=True)
class Trend:
    """The straight line through densities over time."""

    count: int
    mean_kg_m3: float
    per_day_kg_m3: float
    """Its slope."""
    sigma_per_day_kg_m3: float
    """One standard deviation of the slope, from the scatter about the line; NaN for two values."""


def weigh(
    readings: Sequence[ScaleReading], since_ns: int, until_ns: int, settings: ScaleSettings
) -> Weighing:
    """Return what passed the scale in a period, from readings in the order of time.

    Between two readings the counter is interpolated; its σ there is that of a value anywhere between both.
    """
    if len(readings) < 2 or readings[0].wall_ns > since_ns or readings[-1].wall_ns < until_ns:
        return Weighing(math.nan, math.nan, "no reading of the scale before its begin or after its end")
    times = np.array([reading.wall_ns for reading in readings], np.int64)
    counts = np.array([reading.kg for reading in readings], np.float64)
    steps = np.diff(counts)
    first = max(int(np.searchsorted(times, since_ns, side="right")) - 1, 0)
    last = min(int(np.searchsorted(times, until_ns, side="left")), len(times) - 1)
    if settings.rolls_over_kg is not None:
        steps = np.where(steps < 0, steps + settings.rolls_over_kg, steps)
    if np.any(steps[first:last] < 0):
        return Weighing(math.nan, math.nan, "the counter of the scale was reset in between")
    counted = np.concatenate([[0.0], np.cumsum(steps[first:last])])
    inside = times[first : last + 1] - since_ns
    at = (0, until_ns - since_ns)
    begin, end = (float(np.interp(place, inside, counted)) for place in at)
    unsure = [_UNIFORM * _surround(inside, counted, place) for place in at]
    mass = end - begin
    parts = (
        settings.sigma_percent / 100 * mass,
        *(2 * [_UNIFORM * settings.resolution_kg]),
        *unsure,
    )
    return Weighing(mass, math.hypot(*parts))


def _surround(times: np.ndarray, counts: np.ndarray, place: int) -> float:
    """Return what was counted between the readings around an instant; 0 where one was taken at it."""
    after = int(np.searchsorted(times, place, side="left"))
    if after >= len(times) or times[after] == place:
        return 0.0
    return float(counts[after] - counts[max(after - 1, 0)])


def compare(weighing: Weighing, sums: ProductionSums, product: ProductSettings | None) -> WeighedVolume:
    """Return a weighing against the sums of the same time; ``product``: the only one on the belt, None: several.

    Belt without a measurement is taken to have carried the mean load, give or take anything from none to twice it.
    """
    missing = sums.missing_mm / sums.length_mm if sums.length_mm > 0 else 1.0
    reason = weighing.reason
    if not reason and (missing > _MOST_MISSING or sums.volume_mm3 <= 0):
        reason = "no load was measured" if sums.volume_mm3 <= 0 else "too much belt was not measured"
    if reason:
        nan = math.nan
        return WeighedVolume(weighing, nan, nan, nan, nan, nan, nan, reason)
    whole = 1 / (1 - missing)
    guess = 2 * _UNIFORM * missing * whole
    volume_m3 = sums.volume_mm3 * whole * 1e-9
    density = weighing.kg / volume_m3
    relative = math.hypot(sums.sigma_mm3 / sums.volume_mm3, guess)
    sigma = math.hypot(weighing.sigma_kg / volume_m3, density * relative)
    mass_sigma = math.hypot(sums.mass_sigma_kg, sums.mass_kg * guess) * whole
    deviation = weighing.kg - sums.mass_kg * whole
    moisture = _estimate_moisture(density, sigma, product)
    return WeighedVolume(
        weighing, density, sigma, *moisture, deviation, math.hypot(weighing.sigma_kg, mass_sigma)
    )


def _estimate_moisture(density: float, sigma: float, product: ProductSettings | None) -> tuple[float, float]:
    """Return the moisture, percent, if the dry bulk density is the product's, and its σ."""
    if product is None or product.moisture_percent is None or density <= 0:
        return math.nan, math.nan
    solid = 1 - product.moisture_percent / 100
    dry = product.density_kg_m3 * solid
    parts = dry / density**2 * sigma, solid / density * product.sigma_kg_m3
    return 100 * (1 - dry / density), 100 * math.hypot(*parts)


def fit_trend(densities: Sequence[tuple[int, float]]) -> Trend | None:
    """Return the least-squares line through (time in ns, density); None for fewer than two times."""
    if len({time for time, _ in densities}) < 2:
        return None
    days = np.array([(time - densities[0][0]) / _DAY_NS for time, _ in densities])
    values = np.array([value for _, value in densities])
    apart = days - days.mean()
    slope = float(apart @ values / (apart @ apart))
    rest = values - values.mean() - slope * apart
    free = len(values) - 2
    sigma = math.sqrt(float(rest @ rest) / free / float(apart @ apart)) if free > 0 else math.nan
    return Trend(len(values), float(values.mean()), slope, sigma)
