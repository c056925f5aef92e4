"""The belt followed over its revolutions: carry-back in its own total, splices and torn edges with their position."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.health.belt.residue import BesideLoad, CellRows, StripAverage, measure_strips
from beltscape.health.belt.splices import SpliceBand
from beltscape.health.belt.torn_edges import EdgeHistory

_LONGEST_RIDGE_MM = 1500.0
"""A longer rise is no splice."""
_LEAST_TEAR_ROWS = 2
"""Rows over which an edge must recede to count as torn: a single one is scatter."""
_BRIDGED_ROWS = 3
"""Hidden rows that do not end a splice or a tear: a tenth of the belt's width."""
_LONGEST_TEAR_MM = 3000.0
"""A longer change of an edge is the belt running off."""
_STUCK_MM = 1.0
"""Least height that must be found again after a revolution."""
_SAME_PLACE_MM = 100.0
"""Events of one revolution and the next at the same place differ by less, with the encoder's scale and slip."""

Kind = Literal["splice", "torn left edge", "torn right edge"]
_EDGES: tuple[Kind, Kind] = ("torn left edge", "torn right edge")


@dataclass(frozen=True, slots=True)
class BeltEvent:
    """Something that belongs to the belt itself and passed."""

    kind: Kind
    position_mm: float
    """Belt coordinate of its middle; within one revolution if the belt's length is known."""
    length_mm: float
    """Along the belt."""
    size_mm: float
    """Height of a splice; depth of a tear across the belt."""
    is_loaded: bool
    """Whether a load lay beside it, some of which may have fallen through a tear."""
    passes: int
    """Number of times that it was recognised at this place."""


@dataclass(slots=True)
class _Run:
    """Consecutive rows with a ridge or a receded edge."""

    first: int
    last: int
    sizes: list[float] = field(default_factory=list)
    is_loaded: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    """A row of the belt."""

    number: int
    over_mm: NDArray[np.float64]
    """(m,) heights over the belt as it lies."""
    bare: NDArray[np.bool_]
    """(m,) which cells show the bare belt."""
    area_mm2: float
    """Cross-section of the material on it."""


class BeltPasses:
    """Collects the rows of a moving belt, each once, by belt coordinate; unknown rows end what was open."""

    def __init__(self, side_mm: float, length_mm: float | None, empty_mm: float) -> None:
        """``side_mm`` is the edge of a cell, ``length_mm`` that of the endless belt.

        Material counts as residue on stretches that are empty for ``empty_mm``.
        """
        self._side_mm, self._length_mm, self._empty_mm = side_mm, length_mm, empty_mm
        self._pending: list[_Row] = []
        """The rows of the present empty stretch while it is too short to count."""
        self._stretch_mm = 0.0
        """Length of the present empty stretch."""
        self._next: int | None = None
        self._runs: dict[Kind, _Run] = {}
        self._edges: dict[Kind, EdgeHistory] = {kind: EdgeHistory(side_mm) for kind in _EDGES}
        self._seen: list[BeltEvent] = []
        self._splice_mm = -np.inf
        """Belt coordinate of the splice that was found last."""
        self._last: dict[int, tuple[int, NDArray[np.float32]]] = {}
        """By row of the belt, when it last was empty: its number since the start, and the heights of its material."""
        self._strips = StripAverage(side_mm, empty_mm)
        self._strips_mm3 = 0.0
        """Material beside the load in the rows that were added last."""
        self.residue_mm3 = 0.0
        """Material on otherwise empty belt, and beside a load where it was counted."""
        self.stuck_mm3 = 0.0
        """Part of it that was at the same place a revolution before."""
        self.empty_mm = 0.0
        """Length of otherwise empty belt."""

    @property
    def is_empty(self) -> bool:
        """Return whether the belt has been empty for so long that material on it is residue."""
        return self._stretch_mm >= self._empty_mm

    @property
    def beside_load(self) -> BesideLoad:
        """Return what lies on the strips beside the load, over the length that counts as an empty stretch."""
        return self._strips.average

    def count_strips(self) -> None:
        """Count what the rows of the last `add` hold beside the load as residue."""
        self.residue_mm3 += self._strips_mm3

    def add(
        self, rows: CellRows, position_mm: float, direction: int, splice: SpliceBand | None = None
    ) -> list[BeltEvent]:
        """Add the rows of a frame that were not in view before; return the events that they complete.

        The rows that enter the view wait until they are so far inside that a load behind them is in view. A
        ``splice`` that is in view as a whole is returned at once; a longer one is followed by its rows.
        """
        s = position_mm - direction * rows.y_mm
        numbers = np.rint(s / self._side_mm).astype(np.int64)
        order = np.argsort(numbers)[: len(numbers) - rows.margin]
        if self._next is None or numbers.max() < self._next - 2 * len(numbers):
            self._next = int(numbers.min())  # the first frame, or an encoder that began anew
        if numbers.min() > self._next:
            self._runs.clear()
            self._end_stretch()
            for edge in self._edges.values():
                edge.clear()
        events: list[BeltEvent] = []
        if splice is not None:
            rows = replace(rows, bare=rows.bare | splice.raised)
            middle = position_mm - direction * splice.middle_mm
            events.append(
                BeltEvent("splice", middle, splice.length_mm, splice.height_mm, splice.is_loaded, 1)
            )
        empty, area, ridge = rows.is_empty, rows.area_mm2, rows.ridge_mm
        is_new = np.zeros(len(numbers), bool)
        is_new[order] = numbers[order] >= self._next
        events += self._follow_edges(rows, numbers, is_new)
        strips, self._strips_mm3 = measure_strips(rows), 0.0
        is_spliced = np.zeros(len(numbers), bool) if splice is None else splice.raised.sum(axis=1) > 0
        for index in order:
            number = int(numbers[index])
            if number < self._next:
                continue
            self._next = number + 1
            self._strips.add(strips[index])
            self._strips_mm3 += float(strips[index, :2].sum()) * self._side_mm**2
            row = _Row(number, rows.over_mm[index], rows.bare[index], float(area[index]))
            if empty[index]:
                self._extend_stretch(row, is_counted=not ridge[index])
            else:
                self._end_stretch()
            is_known = not is_spliced[index] and bool(empty[index] or ridge[index] > 0)
            height = float(ridge[index]) if is_known else np.nan
            events += self._follow("splice", number, height, is_empty=bool(empty[index]))
        return [self._identify(event) for event in events if self._is_new(event)]

    def _is_new(self, event: BeltEvent) -> bool:
        """Return whether an event is no other view of the splice that was found last."""
        if event.kind != "splice":
            return True
        apart = abs(event.position_mm - self._splice_mm)
        self._splice_mm = event.position_mm
        return apart > _SAME_PLACE_MM + event.length_mm / 2

    def _extend_stretch(self, row: _Row, *, is_counted: bool) -> None:
        """Add a row to the empty stretch; a splice belongs to it but is no residue."""
        self._stretch_mm += self._side_mm
        if is_counted:
            self._pending.append(row)
        if self.is_empty:
            for each in self._pending:
                self._count(each)
            self._pending.clear()

    def _end_stretch(self) -> None:
        self._stretch_mm = 0.0
        self._pending.clear()

    def _count(self, row: _Row) -> None:
        self.empty_mm += self._side_mm
        self.residue_mm3 += row.area_mm2 * self._side_mm
        if self._length_mm is None:
            return
        number, period = row.number, max(1, round(self._length_mm / self._side_mm))
        material = np.where(row.bare, 0.0, np.clip(np.nan_to_num(row.over_mm), 0, None)).astype(np.float32)
        near = [self._last.get((number + offset) % period) for offset in (-1, 0, 1)]
        known = [row for one in near if one is not None for at, row in [one] if number - at > period // 2]
        if known:
            common = np.minimum(np.max(known, axis=0), material)
            self.stuck_mm3 += float(common[common >= _STUCK_MM].sum()) * self._side_mm**2
        self._last[number % period] = (number, material)

    def _follow_edges(
        self, rows: CellRows, numbers: NDArray[np.int64], is_new: NDArray[np.bool_]
    ) -> list[BeltEvent]:
        """Return the tears that end in a frame; an edge is followed wherever it is bare."""
        events: list[BeltEvent] = []
        for kind, outwards in zip(_EDGES, (slice(None), slice(None, None, -1)), strict=True):
            over, bare = rows.over_mm[:, outwards], rows.bare[:, outwards]
            for row in self._edges[kind].add(numbers, over, bare, is_new, rows.is_empty):
                events += self._follow(kind, row.number, row.size_mm, is_empty=row.is_empty)
            run = self._runs.get(kind)
            if run is not None and (run.last - run.first) * self._side_mm > _LONGEST_TEAR_MM:
                self._edges[kind].forget()
        return events

    def _follow(self, kind: Kind, number: int, size: float, *, is_empty: bool) -> list[BeltEvent]:
        """Return the splice or tear that ends before a row; one whose end is hidden (NaN) for long is none."""
        run = self._runs.get(kind)
        if size > 0:
            run = self._runs.setdefault(kind, _Run(number, number))
            run.last = number
            run.sizes.append(size)
            run.is_loaded |= not is_empty
        elif run is not None and (not np.isnan(size) or number - run.last > _BRIDGED_ROWS):
            del self._runs[kind]
            if not np.isnan(size):
                return self._complete(kind, run)
        return []

    def _complete(self, kind: Kind, run: _Run) -> list[BeltEvent]:
        length = (run.last + 1 - run.first) * self._side_mm
        longest = _LONGEST_RIDGE_MM if kind == "splice" else _LONGEST_TEAR_MM
        rows = run.last + 1 - run.first
        if length > longest or (kind != "splice" and rows < _LEAST_TEAR_ROWS):
            return []
        middle = 0.5 * (run.first + run.last) * self._side_mm
        return [BeltEvent(kind, middle, length, float(np.max(run.sizes)), run.is_loaded, 1)]

    def _identify(self, event: BeltEvent) -> BeltEvent:
        """Return the event with its place on the belt and the number of its passes."""
        if self._length_mm is None:
            return event
        place = event.position_mm % self._length_mm
        for number, known in enumerate(self._seen):
            apart = abs(
                (place - known.position_mm + self._length_mm / 2) % self._length_mm - self._length_mm / 2
            )
            if known.kind == event.kind and apart < _SAME_PLACE_MM + event.length_mm / 2:
                again = replace(event, position_mm=place, passes=known.passes + 1)
                self._seen[number] = again
                return again
        first = replace(event, position_mm=place)
        self._seen.append(first)
        return first
