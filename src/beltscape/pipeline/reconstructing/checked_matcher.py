"""A matcher with a consistency check: inconsistent cameras are excluded, or σ of the depth is raised."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.stereo.cameras import list_usable_auxiliaries
from beltscape.stereo.consistency.check import LEAST_COVERAGE, check_consistency
from beltscape.stereo.consistency.exchange import find_exchange
from beltscape.stereo.consistency.fault_texts import describe_faults
from beltscape.stereo.consistency.low_coverage import diagnose_low_coverage
from beltscape.stereo.consistency.rig_consistency import RigConsistency
from beltscape.stereo.consistency.tolerance import Tolerance, compute_tolerance
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.multiview.settings import MultiviewSettings

GROSS_PX = 2.0
"""If no set of cameras is consistent and residuals exceed this, the depth map is refused as chance matches."""
_AVERAGING_AUXILIARIES = 4
"""The errors of this number of auxiliaries average out; with fewer, σ is raised (2 and a moved core: z 1.5)."""
CHECK_EVERY = 50
"""Number of frames of a moving belt per check; a check takes a few percent of the time of one frame."""


@dataclass(frozen=True, slots=True, eq=False)
class CheckedDepth:
    """Depth of a frame, and the consistency of its cameras."""

    depth: DepthMap
    consistency: RigConsistency | None
    """None: the frame was not checked."""
    auxiliaries: tuple[str, ...]
    """The auxiliaries used for the depth."""
    faults: tuple[str, ...]
    """One line per camera fault, or the likely cause of low coverage."""


class CheckedMatcher:
    """Reconstructs frames and checks the cameras' consistency in every n-th of them."""

    def __init__(
        self,
        rig: Rig,
        auxiliaries: tuple[str, ...],
        depth_range_mm: tuple[float, float],
        make_matcher: Callable[[tuple[str, ...]], Any],
        *,
        every: int = 1,
    ) -> None:
        """``make_matcher`` returns the matcher for a set of auxiliaries; every ``every``-th frame is checked."""
        self.rig = rig
        self.excluded: tuple[str, ...] = ()
        """Auxiliaries that were inconsistent in a frame and are no longer used."""
        self.is_inconsistent = False
        """Whether the last checked frame was inconsistent with the rig."""
        self._auxiliaries, self._near_far, self._every = auxiliaries, depth_range_mm, every
        self._make_matcher = make_matcher
        self._matchers: dict[tuple[str, ...], Any] = {}
        self._tolerance: Tolerance | None = None
        self._exchanged: dict[tuple[str, ...], tuple[str, str] | None] = {}
        self._systematic_px = 0.0
        self._frames = 0
        self._refused = False
        self._reported: tuple[tuple[str, ...], bool] = (), False

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter, *, prior: Any = None) -> DepthMap:
        """Return the depth of a frame; report its faults when they are new."""
        checked = self.measure(frame_set, reporter, prior)
        if checked.consistency is not None:
            state = checked.consistency.inconsistent, checked.consistency.core_moved
            if state != self._reported:
                for line in checked.faults:
                    reporter.warn(line)
            self._reported = state
        return checked.depth

    def measure(self, frame_set: FrameSet, reporter: Reporter, prior: Any = None) -> CheckedDepth:
        """Return the depth of a frame and the consistency of its cameras.

        Raises
        ------
        ReconstructionError
            When its images do not suffice, or the cameras contradict each other grossly.
        """
        is_due = self._refused or self._frames % self._every == 0
        self._frames += 1
        self._refused = False
        names = self._select_auxiliaries(frame_set)
        depth = self._match(names, frame_set, reporter, prior)
        if not is_due:
            return CheckedDepth(self._add_systematic(depth), None, names, ())
        usable = list_usable_auxiliaries(self.rig, frame_set, self._auxiliaries)
        consistency = self._check(frame_set, depth, usable)
        for _ in usable:
            consistent = _select_consistent(consistency)
            if not consistent or consistent == names:
                break
            names = consistent
            depth = self._match(names, frame_set, reporter, None)
            consistency = self._check(frame_set, depth, usable)
        self.excluded = tuple(n for n in usable if n in consistency.inconsistent and n not in names)
        return self._assess(frame_set, depth, consistency, names)

    def _assess(
        self, frame_set: FrameSet, depth: DepthMap, consistency: RigConsistency, names: tuple[str, ...]
    ) -> CheckedDepth:
        """Return the depth, with raised σ if it was measured with inconsistent cameras."""
        self.is_inconsistent = not consistency.is_sound
        faults = describe_faults(consistency, self.rig, self._find_exchange(frame_set, consistency))
        uses_inconsistent = consistency.core_moved or not set(names).isdisjoint(consistency.inconsistent)
        # at low coverage or with gross residuals, an inconsistent camera's pixels match by chance
        is_gross = uses_inconsistent and consistency.misfit_px > GROSS_PX
        if faults and (depth.coverage < LEAST_COVERAGE or is_gross):
            self._refused = True
            raise ReconstructionError(f"frame {frame_set.frame}: {'; '.join(faults)}")
        self._systematic_px = consistency.misfit_px * max(
            1.0, float(np.sqrt(_AVERAGING_AUXILIARIES / len(names)))
        )
        depth = self._add_systematic(depth)
        if uses_inconsistent and faults:
            end = f"σ of the depth includes an error of {depth.systematic_mm:.2f} mm common to all pixels"
        else:
            end = f"the depth is measured without {', '.join(self.excluded)}"
        faults = [f"{line}; {end}" for line in faults]
        if depth.coverage < LEAST_COVERAGE:
            cause, is_unreliable = diagnose_low_coverage(
                frame_set, self.rig, consistency, self._near_far, depth.coverage
            )
            faults = [cause]
            if is_unreliable:
                depth = add_systematic_error(
                    depth, (self._near_far[1] - self._near_far[0]) / float(np.sqrt(12))
                )
        return CheckedDepth(depth, consistency, names, tuple(faults))

    def _select_auxiliaries(self, frame_set: FrameSet) -> tuple[str, ...]:
        """Return the auxiliaries with an image, without the excluded ones unless none remains."""
        usable = list_usable_auxiliaries(self.rig, frame_set, self._auxiliaries)
        return tuple(n for n in usable if n not in self.excluded) or usable

    def _match(self, names: tuple[str, ...], frame_set: FrameSet, reporter: Reporter, prior: Any) -> DepthMap:
        key = tuple(n for n in self._auxiliaries if n not in self.excluded or n in names)
        key = key if set(names) == set(key) & set(frame_set.images) else names
        if key not in self._matchers:
            self._matchers[key] = self._make_matcher(key)
        matcher = self._matchers[key]
        if prior is None:
            return matcher.reconstruct(frame_set, reporter)
        return matcher.reconstruct(frame_set, reporter, prior=prior)

    def _check(self, frame_set: FrameSet, depth: DepthMap, names: tuple[str, ...]) -> RigConsistency:
        if self._tolerance is None:
            middle = 2 / (1 / self._near_far[0] + 1 / self._near_far[1])
            self._tolerance = compute_tolerance(self.rig, middle)
        return check_consistency(frame_set, self.rig, depth, names, self._tolerance)

    def _find_exchange(self, frame_set: FrameSet, consistency: RigConsistency) -> tuple[str, str] | None:
        """Return the two cameras that were exchanged, or None; searched once per set of inconsistent cameras."""
        inconsistent = consistency.inconsistent
        if inconsistent not in self._exchanged:
            self._exchanged[inconsistent] = find_exchange(frame_set, self.rig, consistency)
        return self._exchanged[inconsistent]

    def _add_systematic(self, depth: DepthMap) -> DepthMap:
        if not self._systematic_px or not depth.measured.any():
            return depth
        return add_systematic_error(depth, self._systematic_px * compute_depth_error_per_px(self.rig, depth))


def make_sequence_matcher(
    rig: Rig, cameras: Collection[str], depth_range_mm: tuple[float, float], settings: MultiviewSettings
) -> CheckedMatcher:
    """Return the matcher of a moving belt; its first frame is checked, and every `CHECK_EVERY`-th after it."""

    def make_matcher(names: tuple[str, ...]) -> MultiviewReconstructor:
        return MultiviewReconstructor(rig, depth_range_mm, settings, auxiliaries=names)

    auxiliaries = tuple(name for name in rig.auxiliaries if name in cameras)
    return CheckedMatcher(rig, auxiliaries, depth_range_mm, make_matcher, every=CHECK_EVERY)


def _select_consistent(consistency: RigConsistency) -> tuple[str, ...]:
    """Return the auxiliaries to measure with; none if the frame is ambiguous."""
    if consistency.core_moved or consistency.ambiguous or not consistency.find_auxiliaries("sound"):
        return ()
    return tuple(each.camera for each in consistency.cameras if each.camera not in consistency.inconsistent)


def compute_depth_error_per_px(rig: Rig, depth: DepthMap) -> float:
    """Return the depth error (mm) of a pixel of disparity at the map's median depth, over the mean baseline."""
    baseline = float(np.mean([np.linalg.norm(rig.cam_from_core[n].center_mm) for n in rig.auxiliaries]))
    middle = float(np.nanmedian(depth.depth_mm))
    return middle**2 / (float(rig.core_camera.focal_px.mean()) * baseline)


def add_systematic_error(depth: DepthMap, systematic_mm: float) -> DepthMap:
    """Return the map with an error common to all pixels added to its σ."""
    sigma = np.hypot(depth.sigma_mm, np.float32(systematic_mm)).astype(np.float32)
    return replace(depth, sigma_mm=sigma, systematic_mm=systematic_mm)
