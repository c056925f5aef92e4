"""Both ledgers over equal intervals of time, or of belt where the frames have no common clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from beltscape.reprocessing.comparison.ledger import NO_TIME, Codes, Numbers
from beltscape.reprocessing.comparison.segments import Segments
from beltscape.reprocessing.comparison.uncertainty import PairedSums

_COUNT = 200
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
    least = max((high - low) / _COUNT, float(np.median(np.diff(places))) if len(places) > 1 else 0.0)
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
