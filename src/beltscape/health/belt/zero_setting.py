"""Setting the zero: the learned belt is moved to where the empty belt now lies, within a limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt
from beltscape.core.errors import MeasureError
from beltscape.core.geometry.pose import Pose
from beltscape.core.translatable_message import make_message
from beltscape.health.belt.cells import BeltCells, compute_belt_cells
from beltscape.health.belt.zero_finding import find_largest_tilt
from beltscape.health.belt.zero_shift import ZeroShift, estimate_zero_shift
from beltscape.health.settings import BeltLimits
from beltscape.measure.belt.reference import EmptyBeltReference, make_reference

_LEAST_BARE = 0.85
"""Least share of the measured cells that must be bare; dirt and markers on the belt hide some."""
_LEAST_MEASURED = 0.5
"""Least share of the cells in view that must be measured."""
_LARGEST_SPREAD_MM = 0.2
"""Largest standard deviation of the frames' shifts; belts vary less in thickness."""
_ROUNDS = 3
"""The motion is estimated again from the moved reference, as tilts are taken as small."""


@dataclass(frozen=True, slots=True, eq=False)
class ZeroSetting:
    """A new zero, and the motion of the belt that it accounts for."""

    reference: EmptyBeltReference
    """The reference moved to the present belt; its σ includes that of the motion."""
    offset_mm: float
    """Mean rise of the belt since it was learned."""
    sigma_mm: float
    """One standard deviation of it."""
    tilt_mm: float
    """Largest rise of an edge or end of the view by tilt or lateral shift."""
    frames: int


def zero_offset(
    depths: Sequence[DepthMap], reference: EmptyBeltReference, limits: BeltLimits | None = None
) -> ZeroSetting:
    """Return the reference moved to the belt in depth maps of the empty running belt.

    Raises
    ------
    MeasureError
        if the belt is not empty, the frames contradict each other, or the motion exceeds the limit.
    """
    limits = limits or BeltLimits()
    if not depths:
        raise MeasureError("zero: no frame given; give frames of the empty running belt")
    shifts = [
        _estimate_on_empty_belt(depth, reference, limits, number) for number, depth in enumerate(depths)
    ]
    offsets = np.array([shift.offset_mm for shift in shifts])
    offset, spread = float(np.mean(offsets)), float(np.std(offsets))
    if spread > max(_LARGEST_SPREAD_MM, 4 * max(shift.sigma_mm for shift in shifts)):
        extent = f"shifts of {offsets.min():+.2f} to {offsets.max():+.2f} mm"
        raise MeasureError(
            make_message("zero_set_scatter", subject="zero", detail=extent, spread=round(spread, 2))
        )
    tilt = max((find_largest_tilt(shift)[0] for shift in shifts), key=abs)
    for name, value in (("rise", offset), ("tilt", tilt)):
        if abs(value) > limits.set_limit_mm:
            limit, shown = limits.set_limit_mm, round(value, 2)
            raise MeasureError(make_message(f"zero_set_{name}", subject="zero", value=shown, limit=limit))
    moved = reference
    for _ in range(_ROUNDS):
        cells = [compute_belt_cells(depth, moved) for depth in depths]
        motions = [
            estimate_zero_shift(own, moved.belt, moved.cell_mm, limits.search_mm).motion_mm for own in cells
        ]
        moved = _move(moved, np.mean(motions, axis=0), cells[0])
    average = np.sqrt(np.mean([s.sigma_mm**2 - s.common_mm**2 for s in shifts]) / len(shifts))
    common = max(shift.common_mm for shift in shifts)
    sigma = float(np.sqrt(average**2 + common**2 + spread**2 / len(shifts)))
    belt = replace(moved.belt, drift_mm=float(np.hypot(moved.belt.drift_mm, sigma)))
    return ZeroSetting(_with_belt(moved, belt), offset, sigma, tilt, len(depths))


def _estimate_on_empty_belt(
    depth: DepthMap, reference: EmptyBeltReference, limits: BeltLimits, number: int
) -> ZeroShift:
    cells = compute_belt_cells(depth, reference)
    shift = estimate_zero_shift(cells, reference.belt, reference.cell_mm, limits.search_mm)
    subject = f"zero: frame {number}"
    if not shift.is_measured or len(cells) < _LEAST_MEASURED * cells.shape[0] * cells.shape[1]:
        raise MeasureError(make_message("zero_set_not_bare", subject=subject, share=0))
    share = float(shift.bare.mean())
    if share < _LEAST_BARE or not min(shift.sides):
        raise MeasureError(make_message("zero_set_not_bare", subject=subject, share=round(100 * share)))
    return shift


def _move(
    reference: EmptyBeltReference, motion_mm: NDArray[np.float64], cells: BeltCells
) -> EmptyBeltReference:
    """Return the reference after a motion (5,) of the belt, see `ZeroShift.motion_mm`."""
    belt = reference.belt
    low, high = belt.across_mm
    half_x, half_y = (high - low) / 2, max(cells.shape[0] * cells.side_mm / 2, 1.0)
    rise, across, along, lateral, yaw = motion_mm / [1.0, half_x, half_y, 1.0, half_y]
    middle = np.array([(low + high) / 2, cells.y_middle_mm, 0.0])
    turn = Pose.of(np.array([-along, across, yaw]), np.zeros(3)).rotation
    # points of the present belt come to lie on the learned surface
    back = Pose(turn, middle - turn @ middle - [lateral, 0.0, rise])
    return _with_belt(reference, replace(belt, belt_from_core=back @ belt.belt_from_core))


def _with_belt(reference: EmptyBeltReference, belt: Belt) -> EmptyBeltReference:
    return make_reference(belt, reference.camera, reference.cell_mm)
