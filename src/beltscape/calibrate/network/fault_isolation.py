"""Which camera, or which pair, the others contradict: told from the loops that do not close."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from beltscape.calibrate.network.association import CameraNetwork, LoopError

FAULT_RATIO = 12.0
"""A loop's χ² per degree of freedom, over the common scale, from which on noise does not explain it."""
SINGLE_LOOP_RATIO = 100.0
"""The same where a single loop, or none, tells the common scale."""


@dataclass(frozen=True, slots=True)
class CameraFault:
    """Who opens the loops."""

    cameras: tuple[str, ...]
    """One camera; the two of a pair; or all that are in question, where the loops cannot tell."""
    excess: float
    """Median χ² per degree of freedom of their loops, over that of all others."""
    rotation_deg: float
    """Worst of their loops."""
    translation_mm: float
    """Worst of their loops."""

    def describe(self) -> str:
        """In words, with what to look for."""
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
    """The guilty camera or pair in words; None where all loops close as well as each other."""
    fault = isolate_fault(network.loop_errors)
    return fault.describe() if fault else None


def isolate_fault(loops: Sequence[LoopError]) -> CameraFault | None:
    """Who opens loops beyond the common scale.

    Errors that all loops share, as those of a bent board, raise all χ² alike: what counts is a loop's χ² per degree
    of freedom over the median of the loops that a suspect is no part of (never below 1). A suspect is guilty when
    most of its loops are outstanding and no other loop is; of several, the one that is part of fewest loops, so
    that a pair goes before its cameras. Where no single suspect explains all, all with outstanding loops are named.
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
    ):  # against most of the loops, or the best one
        scale = _compute_scale(loops, summary)
        open_loops = [loop for loop in loops if loop.chi2_per_dof > limit * scale]
        if open_loops:
            return _make_fault(
                dict.fromkeys(n for loop in open_loops for n in loop.cameras), open_loops, scale
            )
    return None


def _test_candidate(candidate: tuple[str, ...], loops: Sequence[LoopError]) -> CameraFault | None:
    own = [loop for loop in loops if set(candidate) <= set(loop.cameras)]
    others = [loop for loop in loops if loop not in own]
    if not others:
        return None
    scale = _compute_scale(others, _lower_median)
    if _compute_scale(others, max) > FAULT_RATIO * scale:
        return None
    fault = _make_fault(candidate, own, scale)
    return fault if fault.excess > FAULT_RATIO else None


def _compute_scale(loops: Sequence[LoopError], summary: Callable[[list[float]], float]) -> float:
    return max(1.0, summary([loop.chi2_per_dof for loop in loops]))


def _lower_median(values: list[float]) -> float:
    """The lower one of two: between a closed and an open loop there is no middle."""
    return float(np.percentile(values, 50, method="lower"))


def _make_fault(candidates: Iterable[str], own: Sequence[LoopError], scale: float) -> CameraFault:
    return CameraFault(
        cameras=tuple(candidates),
        excess=_lower_median([loop.chi2_per_dof for loop in own]) / scale,
        rotation_deg=max(loop.rotation_deg for loop in own),
        translation_mm=max(loop.translation_mm for loop in own),
    )
