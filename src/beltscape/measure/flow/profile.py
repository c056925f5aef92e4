"""The load along the belt, row by row, and its integral over any stretch, in which partial rows count partly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.measure.flow.blocks import Rows

_HISTORY_MM = 5000.0
"""Length of belt whose cross-sections are kept for bridging gaps."""
_RIM_MM = 30.0
"""Length beside a gap over which the cross-section at its end is averaged."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """The load between two positions of the belt."""

    length_mm: float
    volume_mm3: float
    """Measured and bridged volume."""
    seen_mm: float
    """Length that was in a frame's view."""
    bridged_mm: float
    """Length that was interpolated between stretches in view."""
    share: float
    """Share of the whole stretch that was measured."""
    single_share: float
    """Share of the stretch that one frame measures, on average."""
    apart_mm6: float
    """Variance of errors that are independent of those of other stretches."""
    edges_mm3: float
    """σ of the errors common to all edges."""
    holes_mm3: float
    """σ of the errors common to all holes."""


def make_unmeasured_stretch(length_mm: float) -> Stretch:
    """Return a stretch on which nothing was measured."""
    return Stretch(length_mm, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class UnseenStretch:
    """A stretch that was in no frame's view."""

    start_mm: float
    end_mm: float
    areas_mm2: tuple[float, float] | None
    """Cross-sections at its ends, interpolated between; None: not bridged."""
    sigma_mm2: float
    """σ of the mean cross-section between."""

    def overlap(self, start_mm: float, end_mm: float) -> tuple[float, float]:
        """Return the part of the gap between two positions; (0, 0) if there is none."""
        low, high = max(start_mm, self.start_mm), min(end_mm, self.end_mm)
        return (low, high) if high > low else (0.0, 0.0)

    def volume_mm3(self, low_mm: float, high_mm: float) -> float:
        """Return the interpolated volume between two positions within the gap."""
        if self.areas_mm2 is None:
            return 0.0
        middle = (0.5 * (low_mm + high_mm) - self.start_mm) / (self.end_mm - self.start_mm)
        first, second = self.areas_mm2
        return (high_mm - low_mm) * (first + middle * (second - first))


class Profile:
    """Rows in the order of the belt; rows older than some metres that are no longer needed are discarded."""

    def __init__(self, cell_mm: float, bridge_mm: float) -> None:
        """Gaps up to ``bridge_mm`` are bridged."""
        self._cell_mm, self._bridge_mm = cell_mm, bridge_mm
        self._table = np.empty((0, 7))
        """(n, 7): s, then a row's numbers in the order of `Rows`."""
        self._gaps: list[UnseenStretch] = []

    @property
    def end_mm(self) -> float | None:
        """Return the end of the profile; None while there is none."""
        return float(self._table[-1, 0] + self._cell_mm / 2) if len(self._table) else None

    def add(self, rows: Rows) -> None:
        """Append rows; a gap before them is bridged where it is not too long."""
        s = self._cell_mm * (rows.first + np.arange(len(rows), dtype=np.float64))
        numbers = (
            rows.area_mm2,
            rows.share,
            rows.single_share,
            rows.apart_mm5,
            rows.edges_mm2,
            rows.holes_mm2,
        )
        table = np.column_stack([s, *numbers])
        start = float(s[0] - self._cell_mm / 2)
        if self.end_mm is not None and start - self.end_mm > self._cell_mm / 2:
            self._gaps.append(self._gap(self.end_mm, start, table))
        self._table = np.concatenate([self._table, table])

    def _gap(self, start_mm: float, end_mm: float, after: NDArray[np.float64]) -> UnseenStretch:
        length = end_mm - start_mm
        if length > self._bridge_mm:
            return UnseenStretch(start_mm, end_mm, None, 0.0)
        rim = max(1, round(_RIM_MM / self._cell_mm))
        ends = float(self._table[-rim:, 1].mean()), float(after[:rim, 1].mean())
        known = np.concatenate([self._table[:, 1], after[:, 1]])
        # the variance of a linear interpolation is a quarter of that between cross-sections this far apart
        lag = min(max(1, round(length / self._cell_mm)), len(known) - 1)
        change = float(np.mean((known[lag:] - known[:-lag]) ** 2)) if lag > 0 else float(known[0] ** 2)
        return UnseenStretch(start_mm, end_mm, ends, float(np.sqrt(0.25 * change)))

    def integrate(self, start_mm: float, end_mm: float) -> Stretch:
        """Integrate between two positions; partial rows count partly."""
        half = self._cell_mm / 2
        s = self._table[:, 0]
        near = slice(*np.searchsorted(s, [start_mm - half, end_mm + half]))
        part = self._table[near]
        overlap = np.minimum(part[:, 0] + half, end_mm) - np.maximum(part[:, 0] - half, start_mm)
        sums = np.clip(overlap, 0, None) @ part[:, 1:]
        seen = float(np.clip(overlap, 0, None).sum())
        volume, apart, bridged = float(sums[0]), float(sums[3]), 0.0
        for gap in self._gaps:
            low, high = gap.overlap(start_mm, end_mm)
            if gap.areas_mm2 is not None and high > low:
                volume += gap.volume_mm3(low, high)
                # one error along the whole gap: distributed so that the parts' variances add up to the whole's
                apart += (high - low) * (gap.end_mm - gap.start_mm) * gap.sigma_mm2**2
                bridged += high - low
        length = end_mm - start_mm if end_mm > start_mm else 0.0
        shares = sums[1:3] / length if length > 0 else self._at(end_mm)[2:4]
        return Stretch(
            length,
            volume,
            seen,
            bridged,
            float(shares[0]),
            float(shares[1]),
            apart,
            float(sums[4]),
            float(sums[5]),
        )

    def area_at_mm2(self, place_mm: float) -> float:
        """Cross-section at the row nearest to a place; NaN where there is none."""
        return float(self._at(place_mm)[1])

    def _at(self, place_mm: float) -> NDArray[np.float64]:
        if not len(self._table):
            return np.full(7, np.nan)
        return self._table[int(np.argmin(np.abs(self._table[:, 0] - place_mm)))]

    def discard_before(self, before_mm: float) -> None:
        """Discard rows before a position, except some metres that serve to estimate the load's variation."""
        limit = before_mm - _HISTORY_MM
        self._table = self._table[np.searchsorted(self._table[:, 0], limit) :]
        self._gaps = [gap for gap in self._gaps if gap.end_mm > limit]
