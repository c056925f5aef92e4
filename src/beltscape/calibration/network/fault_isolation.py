"""Fault isolation in the camera network: the camera or the pair whose loops do not close."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from beltscape.calibration.network.association import CameraNetwork, LoopError

FAULT_RATIO = 12.0
"""Limit of a loop's χ² per degree of freedom over the common scale; above it the loop is open.

In simulation it isolates a camera turned by 0.1° in six of six captures; a board bent by 0.6 mm gives no fault.
"""
SINGLE_LOOP_RATIO = 100.0
"""The same limit if a single loop, or none, determines the common scale."""


@dataclass(frozen=True, slots=True)
class NetworkFault:
    """A camera or pair whose loops do not close."""

    cameras: tuple[str, ...]
    """One camera; the two of a pair; or all candidates, if the loops do not isolate the fault."""
    excess: float
    """Median χ² per degree of freedom of their loops over that of all other loops."""
    rotation_deg: float
    """Largest of their loops."""
    translation_mm: float
    """Largest of their loops."""

    def describe(self) -> str:
        """Return the fault and its likely causes in one line."""
        size = f"by up to {self.rotation_deg:.2g}° and {self.translation_mm:.2g} mm"
        if len(self.cameras) == 1:
            (camera,) = self.cameras
            return (
                f"camera {camera} disagrees in the triangles it is part of, {size}, while the others agree: "
                "it moved, or its clock is off"
            )
        if len(self.cameras) == 2:
            first, second = self.cameras
            return (
                f"pair {first}–{second} disagrees, {size}, while its cameras agree with all others: "
                "their common views are bad, or one of the two moved during the capture"
            )
        return (
            f"cameras {', '.join(self.cameras)} contradict each other, {size}, and the loops cannot tell which is "
            "wrong: one of them moved, or its clock is off"
        )


def describe_fault(network: CameraNetwork) -> str | None:
    """Return the isolated fault in one line; None if all loops close equally well."""
    fault = isolate_fault(network.loop_errors)
    return fault.describe() if fault else None


def isolate_fault(loops: Sequence[LoopError]) -> NetworkFault | None:
    """Return the camera or pair whose loops are open beyond the common scale.

    Errors that all loops share, such as those of a bent board, raise all χ² alike. A loop is therefore compared by
    its χ² per degree of freedom over the median of the loops without the candidate (at least 1). A candidate is at
    fault if most of its loops are open and no other loop is. Pairs are tested before cameras, since they are part of
    fewer loops. If no single candidate explains all open loops, all their cameras are returned.
    """
    loops = [loop for loop in loops if loop.dof]
    cameras = list(dict.fromkeys(name for loop in loops for name in loop.cameras))
    pairs = {two: None for loop in loops for two in combinations(loop.cameras, 2)}
    if len(loops) < 2:
        return (
            _make_fault(cameras, loops, 1.0) if loops and loops[0].chi2_per_dof > SINGLE_LOOP_RATIO else None
        )
    faults = [fault for candidate in pairs if (fault := _test_candidate(candidate, loops))]
    faults = faults or [fault for name in cameras if (fault := _test_candidate((name,), loops))]
    if faults:
        return max(faults, key=lambda fault: fault.excess)
    for summary, limit in (
        (_lower_median, FAULT_RATIO),
        (min, SINGLE_LOOP_RATIO),
    ):  # relative to most of the loops, or to the best one
        scale = _compute_scale(loops, summary)
        open_loops = [loop for loop in loops if loop.chi2_per_dof > limit * scale]
        if open_loops:
            return _make_fault(
                dict.fromkeys(n for loop in open_loops for n in loop.cameras), open_loops, scale
            )
    return None


def _test_candidate(candidate: tuple[str, ...], loops: Sequence[LoopError]) -> NetworkFault | None:
    candidate_loops = [loop for loop in loops if set(candidate) <= set(loop.cameras)]
    others = [loop for loop in loops if loop not in candidate_loops]
    if not others:
        return None
    scale = _compute_scale(others, _lower_median)
    if _compute_scale(others, max) > FAULT_RATIO * scale:
        return None
    fault = _make_fault(candidate, candidate_loops, scale)
    return fault if fault.excess > FAULT_RATIO else None


def _compute_scale(loops: Sequence[LoopError], summary: Callable[[list[float]], float]) -> float:
    return max(1.0, summary([loop.chi2_per_dof for loop in loops]))


def _lower_median(values: list[float]) -> float:
    """Return the median, of two middle values the lower: the mean of a closed and an open loop has no meaning."""
    return float(np.percentile(values, 50, method="lower"))


def _make_fault(
    candidates: Iterable[str], candidate_loops: Sequence[LoopError], scale: float
) -> NetworkFault:
    return NetworkFault(
        cameras=tuple(candidates),
        excess=_lower_median([loop.chi2_per_dof for loop in candidate_loops]) / scale,
        rotation_deg=max(loop.rotation_deg for loop in candidate_loops),
        translation_mm=max(loop.translation_mm for loop in candidate_loops),
    )
