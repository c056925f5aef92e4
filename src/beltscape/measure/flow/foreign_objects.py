"""The check of the heights against the belt's motion: what does not travel with the belt is no load.

Every part of the belt is seen by several frames. Where one of them shows more than another shows around the same
place of the belt, something is there that does not lie on it: a jammed lump, a plate, an arm, a cable, a bird.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.alarm_catalogue import FOREIGN_OBJECT
from beltscape.core.arrays import Mask
from beltscape.core.findings import Finding
from beltscape.core.translatable_message import make_message
from beltscape.measure.flow.location import Location

Heights = NDArray[np.float32]

_AROUND_MM = 30.0
"""The load may be as high as another frame shows it within this distance: rims and hidden sides of rocks differ by as
much. On another renderer's heap with rocks of up to 79 mm no cell of 90 pairs of frames was higher by 8 mm then."""
_HIGHER_MM = 10.0
"""A cell is foreign if it is higher by more than this; noise, wear and a risen belt stay below it. Chosen."""
_NARROWEST_MM = 12.0
"""What is narrower is not followed: single wrong cells."""
_LEAST_MM2 = 600.0
"""Least area of an object, a square of 25 mm. Chosen."""
_RIM_MM = 20.0
"""Its rim is left out as well: matching widens an object by about half a window. Chosen."""
_LEAST_OVERLAP = 0.1
"""Share of the view that two frames must have in common to be compared."""
_VIEWS = 8
"""Number of earlier frames that are kept over the length of the view, beside the latest one."""
_SAME_PLACE = 0.5
"""Share of an area that was there in the frame before, from which on it stands at the same place. Chosen."""
_LARGE_LOAD = 0.25
"""Share of the view from which on a load would have been registered: if it was not, the motion is uncertain."""
_LEAST_LOAD_MM = 3.0
"""What is higher counts as load, as in the registration."""
_LEFT_SHARE, _UNPROVEN_SHARE = 0.25, 1.0
"""One standard deviation of what remains of it, as a share of the volume that is left out: where the load's motion
is proven, and where nothing but the object shows whether the belt moves. On composed plates, arms, cables and lumps
up to 0.1 of the volume remained."""
_NAN = float("nan")


@dataclass(slots=True, eq=False)
class _View:
    """A frame on the static grid."""

    number: int
    position_mm: float
    height_mm: Heights
    """(Ny, Nx) over the empty belt; NaN where not measured."""
    roof_mm: Heights
    """(Ny, Nx) largest height around each cell; NaN where little is known."""
    appeared: Mask
    """(Ny, Nx) cells that are higher than the same belt was before; not yet certain to be foreign."""
    foreign: Mask
    """(Ny, Nx) cells that are not load."""


@dataclass(frozen=True, slots=True, eq=False)
class ForeignObjects:
    """The result of one frame."""

    finding: Finding
    masks: Mapping[int, Mask] = field(default_factory=dict[int, Mask])
    """By number of the frame: its cells (Ny, Nx) on the static grid that are not load."""


class ForeignObjectCheck:
    """Compares each frame with earlier ones at the same place of the belt; bounded in memory."""

    def __init__(self, cell_mm: float, length_mm: float) -> None:
        """``cell_mm`` is the edge of a cell of the static grid, ``length_mm`` the view's length along the belt."""
        self._cell_mm, self._length_mm = cell_mm, length_mm
        self._views: deque[_View] = deque()

    def follow(self, number: int, height_mm: Heights, location: Location, direction: int) -> ForeignObjects:
        """Return what is foreign in a located frame with heights (Ny, Nx) on the static grid, and in earlier ones.

        ``direction`` of travel is +1 towards +y. A frame whose place is not known well enough is not judged.
        """
        if location.has_turned or location.relocated:
            self._views.clear()
        place = location.place
        if place is None or place.source == "speed" or location.contradiction is not None:
            return _make_unjudged()
        return self.check(
            number, place.position_mm, direction, height_mm, is_proven=location.shift is not None
        )

    def check(
        self, number: int, position_mm: float, direction: int, height_mm: Heights, *, is_proven: bool
    ) -> ForeignObjects:
        """Return what is foreign in a frame at a position of the belt, and in earlier ones.

        ``is_proven``: the load's own motion confirms the position.
        """
        now = self._make_view(number, position_mm, height_mm)
        return self._decide(now, self._compare(now, direction), direction, is_proven=is_proven)

    def preview(self, position_mm: float, direction: int, height_mm: Heights) -> tuple[Mask, dict[int, Mask]]:
        """Return the cells that would be foreign in a frame at this position, and by number those of earlier ones."""
        now = self._make_view(-1, position_mm, height_mm)
        gone = self._compare(now, direction)
        return self._select_large(now.appeared), {
            view.number: view.foreign | view.appeared | self._select_large(cells) for view, cells in gone
        }

    def _make_view(self, number: int, position_mm: float, height_mm: Heights) -> _View:
        nothing = np.zeros(height_mm.shape, bool)
        return _View(number, position_mm, height_mm, self._raise_roof(height_mm), nothing, nothing)

    def _compare(self, now: _View, direction: int) -> list[tuple[_View, Mask]]:
        """Set what appeared in a view; return the earlier ones with the cells that vanished in it."""
        vanished: list[tuple[_View, Mask]] = []
        for before in self._views:
            rows = round(direction * (now.position_mm - before.position_mm) / self._cell_mm)
            if abs(rows) > (1 - _LEAST_OVERLAP) * len(now.height_mm):
                continue
            now.appeared = now.appeared | self._find_higher(now, before.roof_mm, rows)
            is_back = now.position_mm < before.position_mm - self._cell_mm
            roof_mm = self._cut_ends(now.roof_mm) if is_back else now.roof_mm
            vanished.append((before, self._find_higher(before, roof_mm, -rows)))
        return vanished

    def _decide(
        self, now: _View, vanished: list[tuple[_View, Mask]], direction: int, *, is_proven: bool
    ) -> ForeignObjects:
        """Return what is foreign by what the earlier frames show and this one does not, and the reverse."""
        now.appeared = self._select_large(now.appeared)
        gone = [(before, self._select_large(cells)) for before, cells in vanished]
        if not is_proven and self._is_motion_wrong([*gone, (now, now.appeared)]):
            now.appeared = np.zeros_like(now.appeared)
            self._keep(now)
            return _make_unjudged()
        last = self._views[-1] if self._views else now
        is_certain = any(cells.any() for _, cells in gone) or self._stays(last, now, direction)
        found: list[_View] = []
        for view, cells in (*gone, (last, last.appeared), (now, now.appeared)):
            if is_certain and cells.any():
                view.foreign = view.foreign | self._add_rim(cells)
                view.roof_mm = self._raise_roof(np.where(view.foreign, np.nan, view.height_mm))
                found.append(view)
        self._keep(now)
        if now.appeared.any() and not is_certain:
            return _make_unjudged()
        return ForeignObjects(
            self._describe(found, is_proven=is_proven), {view.number: view.foreign for view in found}
        )

    def _describe(self, found: Sequence[_View], *, is_proven: bool) -> Finding:
        """Return the finding of the views with foreign cells."""
        if not found:
            return Finding(FOREIGN_OBJECT, 0.0, _NAN, _LEAST_MM2, "mm²")
        area_mm2 = max(float(view.foreign.sum()) for view in found) * self._cell_mm**2
        share = _LEFT_SHARE if is_proven else _UNPROVEN_SHARE
        view_mm2 = found[0].height_mm.shape[1] * self._cell_mm * self._length_mm
        systematic_mm = share * max(self._sum_excess(view) for view in found) / view_mm2
        return _make_finding(area_mm2, systematic_mm, is_proven=is_proven)

    def _find_higher(self, view: _View, roof_mm: Heights, rows: int) -> Mask:
        """Return the cells (Ny, Nx) of a view that are higher than another view's roof, moved by ``rows``."""
        with np.errstate(invalid="ignore"):
            return (view.height_mm > _move(roof_mm, rows) + _HIGHER_MM) & ~view.foreign

    @staticmethod
    def _is_motion_wrong(found: Sequence[tuple[_View, Mask]]) -> bool:
        """Return whether there is so much other load that a right motion would have been registered."""
        return any(
            cells.any() and (~cells & (np.nan_to_num(view.height_mm) > _LEAST_LOAD_MM)).mean() >= _LARGE_LOAD
            for view, cells in found
        )

    def _stays(self, last: _View, now: _View, direction: int) -> bool:
        """Return whether what appeared in the last frame stays there, instead of moving with the belt."""
        rows = round(direction * (now.position_mm - last.position_mm) / self._cell_mm)
        if not (last.appeared.any() and now.appeared.any()) or abs(rows) * self._cell_mm < _NARROWEST_MM:
            return False
        moved = _move(last.appeared.astype(np.float32), rows) > 0
        here, travelled = (float((cells & now.appeared).sum()) for cells in (last.appeared, moved))
        return here >= _SAME_PLACE * now.appeared.sum() and here >= travelled

    def _select_large(self, cells: Mask) -> Mask:
        """Return the cells of areas that are wide and large enough."""
        if not cells.any():
            return cells
        side = max(2, round(_NARROWEST_MM / self._cell_mm))
        cells = np.asarray(ndimage.binary_opening(cells, np.ones((side, side))), bool)
        label = np.zeros(cells.shape, np.int32)
        ndimage.label(cells, np.ones((3, 3)), output=label)
        is_large = np.bincount(label.ravel()) * self._cell_mm**2 >= _LEAST_MM2
        is_large[0] = False
        return is_large[label]

    def _cut_ends(self, roof_mm: Heights) -> Heights:
        """Return the roof without the view's ends, where the matcher's windows are cut off.

        Load that rolls back out of the view is measured too low there, and would seem to have vanished.
        """
        ends = 2 * round(_AROUND_MM / self._cell_mm)
        cut = roof_mm.copy()
        cut[:ends] = cut[-ends:] = np.nan
        return cut

    def _add_rim(self, cells: Mask) -> Mask:
        side = 2 * round(_RIM_MM / self._cell_mm) + 1
        return ndimage.maximum_filter(cells, side)

    def _raise_roof(self, height_mm: NDArray[np.floating]) -> Heights:
        """Return the largest height (Ny, Nx) around each cell; NaN where less than half of the cells are known."""
        side = 2 * round(_AROUND_MM / self._cell_mm) + 1
        known = np.isfinite(height_mm)
        lowest = np.where(known, height_mm, -np.inf).astype(np.float32)
        highest = cv2.dilate(
            lowest, np.ones((side, side), np.uint8)
        )  # faster than SciPy's filter, same values
        share = ndimage.uniform_filter(known.astype(np.float32), side)
        return np.where(share > 0.5, highest, np.nan).astype(np.float32)

    def _sum_excess(self, view: _View) -> float:
        """Return the volume that is left out of a view, mm³."""
        return (
            float(np.nansum(np.where(view.foreign, np.clip(view.height_mm, 0, None), 0.0))) * self._cell_mm**2
        )

    def _keep(self, now: _View) -> None:
        """Keep the frame; of the earlier ones those that are apart by a part of the view."""
        least = self._length_mm / _VIEWS
        if len(self._views) >= 2 and abs(self._views[-1].position_mm - self._views[-2].position_mm) < least:
            self._views.pop()
        self._views.append(now)
        while len(self._views) > _VIEWS + 1:
            self._views.popleft()


def _make_unjudged() -> ForeignObjects:
    """Return the result of a frame that was not judged."""
    return ForeignObjects(Finding(FOREIGN_OBJECT, _NAN, _NAN, _LEAST_MM2, "mm²"))


def _make_finding(area_mm2: float, systematic_mm: float, *, is_proven: bool) -> Finding:
    """Return the finding of foreign cells of this area."""
    text = make_message("foreign_object" if is_proven else "foreign_object_alone", area=round(area_mm2 / 100))
    return Finding(
        FOREIGN_OBJECT,
        area_mm2,
        _NAN,
        _LEAST_MM2,
        "mm²",
        text=text,
        effect="degraded",
        systematic_mm=systematic_mm,
    )


def _move(values: Heights, rows: int) -> Heights:
    """Return values (Ny, Nx) moved by whole rows along y; NaN where they come from outside."""
    moved = np.full_like(values, np.nan)
    if rows >= 0:
        moved[rows:] = values[: len(values) - rows]
    else:
        moved[:rows] = values[-rows:]
    return moved
