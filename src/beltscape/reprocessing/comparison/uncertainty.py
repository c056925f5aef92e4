"""Sums of both ledgers over the same belt, or over intervals, with σ of each, and of their difference by the GUM.

The error of a strip has a part of its own and a part that all strips share (edges, holes, slow drift, faults). In a
sum the parts of their own add in squares, the shared parts linearly. In a difference of two measurements of the
same belt the shared part is one error on both sides where rig and empty belt are the same: its correlation is 1, and
only the difference of the two amounts remains. Under other rigs it is taken as independent. The strips' own errors
come from the same images and are alike; they are taken as independent, which can only enlarge σ (JCGM 100:2008, 5.2.2
and F.1.2: u² = u₁² + u₂² - 2 r u₁ u₂ with r ≥ 0).

Intervals are equal in time, or in belt where the frames have no common clock.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from beltscape.core.arrays import Mask
from beltscape.reprocessing.comparison.ledger import NO_TIME, Codes, Numbers
from beltscape.reprocessing.comparison.segments import Segments, Side

COVERAGE_FACTOR = 2.0
"""Multiple of σ within which two values agree: coverage probability 95 % (JCGM 100:2008, 6.3.3)."""


@dataclass(frozen=True, slots=True, eq=False)
class PairedSums:
    """Sums of n stretches in both ledgers, with the terms of σ; sums of sums are sums of all their segments.

    Every pair of rows is first ledger, second ledger.
    """

    length_mm: Numbers
    """(n,) belt that both count."""
    value: Numbers
    """(2, n) volume, mm³, or mass, kg."""
    own: Numbers
    """(2, n) variance of the strips' own errors."""
    common: Numbers
    """(2, n) sum of the shared parts of σ."""
    own_apart: Numbers
    """(n,) variance of the difference by the strips' own errors."""
    common_same: Numbers
    """(2, n) sum of the shared parts that are one error in both ledgers."""
    common_other: Numbers
    """(2, n) sum of those that are not."""
    density_same: Numbers
    """(2, n) kg: volume × σ of the density where both have the same density; 0 for volumes."""
    density_other: Numbers
    """(2, n) kg: the same where they have not."""

    def group(self, group: Codes, count: int) -> PairedSums:
        """Return the sums over ``count`` groups; ``group``: (n,) the group of each, -1: none."""
        kept = group >= 0

        def add(values: Numbers) -> Numbers:
            if values.ndim == 2:
                return np.stack([add(row) for row in values])
            return np.bincount(group[kept], values[kept], count).astype(np.float64)

        return PairedSums(**{field.name: add(getattr(self, field.name)) for field in fields(self)})

    @property
    def difference(self) -> Numbers:
        """Return (n,) second minus first."""
        return self.value[1] - self.value[0]

    @property
    def sigma(self) -> Numbers:
        """Return (2, n) one standard deviation of each."""
        density = self.density_same + self.density_other
        return np.sqrt(self.own + self.common**2 + density**2)

    @property
    def difference_sigma(self) -> Numbers:
        """Return (n,) one standard deviation of the difference."""
        common = _combine(self.common_same, self.common_other)
        density = _combine(self.density_same, self.density_other)
        return np.sqrt(self.own_apart + common**2 + density**2)

    @property
    def agrees(self) -> Mask:
        """Return (n,) whether the difference is within `COVERAGE_FACTOR` σ."""
        return np.abs(self.difference) <= COVERAGE_FACTOR * self.difference_sigma


def sum_volumes(segments: Segments) -> PairedSums:
    """Return the volumes, mm³, of each segment that both ledgers count."""
    sides = segments.first, segments.second
    zeros = np.zeros((2, len(segments.block)))
    return _make_sums(segments, [np.ones(len(side.columns)) for side in sides], zeros, zeros)


def sum_masses(segments: Segments) -> PairedSums:
    """Return the masses, kg, of each segment that both ledgers count; NaN where a load has no density."""
    sides = segments.first, segments.second
    densities = [_take_densities(side) for side in sides]
    sigmas = [np.nan_to_num(side.columns.density_sigma_kg_m3) * 1e-9 for side in sides]
    parts = np.stack(
        [_split(segments, side, side.columns.volume_mm3 * s) for side, s in zip(sides, sigmas, strict=True)]
    )
    taken = [
        [side.take(values) for values in pair]
        for side, pair in zip(sides, zip(densities, sigmas, strict=True), strict=True)
    ]
    same = np.equal(taken[0][0], taken[1][0]) & np.equal(taken[0][1], taken[1][1])
    return _make_sums(segments, densities, np.where(same, parts, 0.0), np.where(same, 0.0, parts))


def measure_with_same_rig(segments: Segments) -> Mask:
    """Return where both ledgers measured with the same rig and empty belt, by the SHA-256 of their runs."""
    codes: dict[tuple[str, str], int] = {}
    each: list[Codes] = []
    for unknown, side in ((-1, segments.first), (-2, segments.second)):
        runs, place = np.unique(side.columns.run, return_inverse=True)
        known: list[int] = []
        for number in runs.tolist():
            run = side.ledger.runs.get(number)
            key = (
                ("", "") if run is None else (run.provenance.get("rig", ""), run.provenance.get("empty", ""))
            )
            known.append(codes.setdefault(key, len(codes)) if all(key) else unknown)
        each.append(np.array(known, np.int64)[place][side.record])
    return each[0] == each[1]


def _make_sums(
    segments: Segments, factors: list[Numbers], density_same: Numbers, density_other: Numbers
) -> PairedSums:
    """Return the sums of volumes times each record's factor, per ledger."""
    sides, same = (segments.first, segments.second), measure_with_same_rig(segments)
    terms = [_make_terms(segments, side, factor, same) for side, factor in zip(sides, factors, strict=True)]
    value, own, common, own_apart, shared = (np.stack(rows) for rows in zip(*terms, strict=True))
    return PairedSums(
        np.where(segments.is_compared, segments.length_mm, 0.0),
        *(value, own, common, own_apart.sum(axis=0)),
        *(np.where(same, shared, 0.0), np.where(same, 0.0, shared), density_same, density_other),
    )


def _make_terms(segments: Segments, side: Side, factor: Numbers, same: Mask) -> tuple[Numbers, ...]:
    """Return value, own variance, shared σ, and both of these for the difference.

    A shared part that is not known is up to all of σ: all of it in the ledger's own sum. In a difference with the
    same rig it would vanish, so there it counts as the strip's own.
    """
    columns = side.columns
    sigma = columns.sigma_mm3 * factor
    known = np.isfinite(columns.common_sigma_mm3)
    common = np.where(known, np.minimum(columns.common_sigma_mm3 * factor, sigma), sigma)
    value = _split(segments, side, columns.volume_mm3 * factor)
    cut = _compute_cut_variance(segments, side, columns.volume_mm3 * factor)
    own = _split(segments, side, sigma**2 - common**2) + cut
    own_apart = np.where(same & ~known[side.record], _split(segments, side, sigma**2) + cut, own)
    shared = _split(segments, side, common)
    remaining = np.where(same, _split(segments, side, np.where(known, common, 0.0)), shared)
    return value, own, shared, own_apart, remaining


def _compute_cut_variance(segments: Segments, side: Side, value: Numbers) -> Numbers:
    """Return the variance by records of which only a part is compared, divided among their segments.

    The load of a record is taken as uniform. For a load that grows linearly from nothing, the part f of it would hold
    f² instead of f: the error is at most f (1 - f) of the value, a rectangular distribution (JCGM 100:2008, 4.3.7).
    """
    compared = segments.is_compared
    part = np.bincount(side.record[compared], side.share[compared], len(side.columns))
    part = np.clip(part, 0.0, 1.0)
    part = np.where(part > 1 - 1e-9, 1.0, part)  # rounding of the shares
    variance = (part * (1 - part) * value) ** 2 / 3
    per_length = np.divide(variance, part, out=np.zeros(len(part)), where=part > 0)
    return _split(segments, side, per_length)


def _split(segments: Segments, side: Side, values: Numbers) -> Numbers:
    return np.where(segments.is_compared, side.split(values), 0.0)


def _take_densities(side: Side) -> Numbers:
    """Return each record's density, kg/mm³; an empty belt needs none."""
    columns = side.columns
    return (
        np.where(columns.volume_mm3 == 0, np.nan_to_num(columns.density_kg_m3), columns.density_kg_m3) * 1e-9
    )


def _combine(same: Numbers, other: Numbers) -> Numbers:
    """Return the shared part of a difference: one error leaves its difference, other errors are independent.

    Both are added linearly, because one ledger may have the one error on both kinds of belt.
    """
    return np.abs(same[1] - same[0]) + np.hypot(other[0], other[1])


_INTERVALS = 200
"""Number of intervals aimed at: as many as a chart shows side by side on a wide screen. Chosen."""
_S = 10**9
"""Nanoseconds of a second."""
_WIDTHS_NS = (*(_S // 10 * k for k in (1, 2, 5)), *(_S * k for k in (1, 2, 5, 10, 15, 30)),
              *(60 * _S * k for k in (1, 2, 5, 10, 15, 30)), *(3600 * _S * k for k in (1, 2, 3, 6, 12)),
              *(86400 * _S * k for k in (1, 2, 7)))  # fmt: skip
"""Round widths of intervals of time."""
_WIDTHS_MM = tuple(step * 10**power for power in range(2, 9) for step in (1, 2, 5))
"""Round widths of intervals of belt."""


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """n successive intervals; a block of belt belongs to the one in which it ends."""

    axis: Literal["time", "belt"]
    start: Codes
    """(n,) beginning of each: trigger time in ns, or position on the belt in mm."""
    width: int
    """Length of each, ns or mm."""
    volume: PairedSums
    """(n,) volumes on the belt that both count."""
    seconds: Numbers
    """(n,) how long that belt took; NaN: its speed is not known, or there is none."""
    of_block: Codes
    """(m,) the interval of each block."""

    @property
    def flow_m3_h(self) -> Numbers:
        """Return (2, n) mean flow of both while the belt moved; NaN: not known."""
        return self.volume.value / self.seconds * 3600e-9

    @property
    def difference_m3_h(self) -> Numbers:
        """Return (n,) the difference of the flows, second minus first."""
        return self.volume.difference / self.seconds * 3600e-9

    @property
    def difference_sigma_m3_h(self) -> Numbers:
        """Return (n,) one standard deviation of that difference."""
        return self.volume.difference_sigma / self.seconds * 3600e-9


def make_intervals(segments: Segments, blocks: PairedSums) -> Intervals:
    """Return the sums of blocks in about 200 intervals of a round width, none shorter than a usual block.

    They are intervals of time if all blocks that are compared have a time and no time lies before an earlier one.
    """
    compared = blocks.length_mm > 0
    times = _find_times(segments, len(compared))
    known = times[compared]
    is_time = bool(len(known)) and not (known == NO_TIME).any() and not (np.diff(known) < 0).any()
    ends = np.zeros(len(compared))
    np.maximum.at(ends, segments.block, segments.edges_mm[:, 1])
    places = times if is_time else np.ceil(ends).astype(np.int64) - 1
    start, width = _choose_grid(places[compared], _WIDTHS_NS if is_time else _WIDTHS_MM)
    of_block = np.where(compared, (places - start) // width, -1)
    count = int(of_block.max()) + 1
    return Intervals(
        axis="time" if is_time else "belt",
        start=start + width * np.arange(count, dtype=np.int64),
        width=width,
        volume=blocks.group(of_block, count),
        seconds=_sum_seconds(segments, of_block, count),
        of_block=of_block,
    )


def _find_times(segments: Segments, count: int) -> Codes:
    """Return the time at which each block's last frame was taken."""
    times = np.full(count, NO_TIME)
    np.maximum.at(times, segments.block, segments.time_ns)
    return times


def _choose_grid(places: Codes, widths: tuple[int, ...]) -> tuple[int, int]:
    """Return the first interval's beginning and the intervals' width."""
    low, high = int(places.min()), int(places.max())
    least = max((high - low) / _INTERVALS, float(np.median(np.diff(places))) if len(places) > 1 else 0.0)
    width = next((each for each in widths if each >= least), None)
    if width is None:
        width = widths[-1] * -(-int(least) // widths[-1])
    return low // width * width, width


def _sum_seconds(segments: Segments, of_block: Codes, count: int) -> Numbers:
    """Return how long the compared belt of each interval took; where a part has no speed, as the rest of it."""
    of_segment = np.where(segments.is_compared, of_block[segments.block], -1)
    seconds, length = segments.seconds, segments.length_mm

    def add(values: Numbers, kept: Codes) -> Numbers:
        return np.bincount(of_segment[kept], values[kept], count).astype(np.float64)

    inside = np.flatnonzero(of_segment >= 0)
    known = inside[np.isfinite(seconds[inside])]
    timed = add(length, known)
    share = np.divide(add(length, inside), timed, out=np.full(count, np.nan), where=timed > 0)
    return add(seconds, known) * share
