"""A matcher whose frames are checked: cameras that contradict the rig are left out, or the depth is marked."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.stereo.cameras import usable_auxiliaries
from beltscape.stereo.consistency.allowance import Allowance, allowance_of
from beltscape.stereo.consistency.check import LEAST_COVERAGE, RigConsistency, camera_consistency
from beltscape.stereo.consistency.exchange import exchange_in_doubt
from beltscape.stereo.consistency.sparse import sparse_cause
from beltscape.stereo.consistency.texts import doubts_of
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.multiview.settings import MultiviewSettings

GROSS_PX = 2.0
"""Where no set of cameras agrees and residuals are greater, a depth map holds chance matches: it is refused."""
_MEAN_OF = 4
"""Over so many auxiliaries errors of single ones cancel; under fewer σ is raised (2 and a moved core: z 1.5)."""
CHECK_EVERY = 50
"""Frames of a moving belt from check to check: a check costs as much as a few percent of a frame, times 1/50."""


@dataclass(frozen=True, slots=True, eq=False)
class CheckedDepth:
    """Depth of a frame, and what the frame says of the cameras."""

    depth: DepthMap
    consistency: RigConsistency | None
    """None: the frame was not checked."""
    auxiliaries: tuple[str, ...]
    """Those that the depth is measured with."""
    doubts: tuple[str, ...]
    """One line per contradiction."""


class CheckedMatcher:
    """Makes depth of frames, and checks every so-manieth of them."""

    def __init__(
        self,
        rig: Rig,
        auxiliaries: tuple[str, ...],
        depth_range_mm: tuple[float, float],
        matcher_of: Callable[[tuple[str, ...]], Any],
        *,
        every: int = 1,
    ) -> None:
        """``matcher_of`` makes the matcher for a set of auxiliaries; every ``every``-th frame is checked."""
        self.rig = rig
        self.left_out: tuple[str, ...] = ()
        """Auxiliaries that contradicted the rig in a frame, and are not used since."""
        self.is_inconsistent = False
        """Whether the frame that was checked last contradicted the rig."""
        self._auxiliaries, self._near_far, self._every = auxiliaries, depth_range_mm, every
        self._matcher_of = matcher_of
        self._matchers: dict[tuple[str, ...], Any] = {}
        self._allowance: Allowance | None = None
        self._exchanged: dict[tuple[str, ...], tuple[str, str] | None] = {}
        self._systematic_px = 0.0
        self._frames = 0
        self._refused = False
        self._reported: tuple[tuple[str, ...], bool] = (), False

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter, *, prior: Any = None) -> DepthMap:
        """Return the depth of a frame; contradictions are reported when they are new."""
        found = self.measure(frame_set, reporter, prior)
        if found.consistency is not None:
            state = found.consistency.doubtful, found.consistency.core_moved
            if state != self._reported:
                for line in found.doubts:
                    reporter.warn(line)
            self._reported = state
        return found.depth

    def measure(self, frame_set: FrameSet, reporter: Reporter, prior: Any = None) -> CheckedDepth:
        """Return the depth of a frame and what it says of the cameras.

        Raises
        ------
        ReconstructionError
            When its images do not suffice, or no set of cameras agrees by far.
        """
        due = self._refused or self._frames % self._every == 0
        self._frames += 1
        self._refused = False
        names = self._used(frame_set)
        depth = self._match(names, frame_set, reporter, prior)
        if not due:
            return CheckedDepth(self._marked(depth), None, names, ())
        everyone = usable_auxiliaries(self.rig, frame_set, self._auxiliaries)
        consistency = self._check(frame_set, depth, everyone)
        for _ in everyone:
            trusted = _trusted(consistency)
            if not trusted or trusted == names:
                break
            names = trusted
            depth = self._match(names, frame_set, reporter, None)
            consistency = self._check(frame_set, depth, everyone)
        self.left_out = tuple(n for n in everyone if n in consistency.doubtful and n not in names)
        return self._judged(frame_set, depth, consistency, names)

    def _judged(
        self, frame_set: FrameSet, depth: DepthMap, consistency: RigConsistency, names: tuple[str, ...]
    ) -> CheckedDepth:
        """Mark the depth where cameras that it is measured with are in doubt."""
        self.is_inconsistent = not consistency.is_sound
        doubts = doubts_of(consistency, self.rig, self._exchange(frame_set, consistency))
        used = consistency.core_moved or not set(names).isdisjoint(consistency.doubtful)
        # what is left where a camera is in doubt and little is measured, is where images agree by chance
        if doubts and (depth.coverage < LEAST_COVERAGE or (used and consistency.misfit_px > GROSS_PX)):
            self._refused = True
            raise ReconstructionError(f"frame {frame_set.frame}: {'; '.join(doubts)}")
        self._systematic_px = consistency.misfit_px * max(1.0, float(np.sqrt(_MEAN_OF / len(names))))
        depth = self._marked(depth)
        if used and doubts:
            end = f"σ of depth holds an error of {depth.systematic_mm:.2f} mm common to all pixels"
        else:
            end = f"depth is measured without {', '.join(self.left_out)}"
        doubts = [f"{line}; {end}" for line in doubts]
        if depth.coverage < LEAST_COVERAGE:
            cause, unfit = sparse_cause(frame_set, self.rig, consistency, self._near_far, depth.coverage)
            doubts = [cause]
            if unfit:
                depth = add_systematic_error(depth, (self._near_far[1] - self._near_far[0]) / float(np.sqrt(12)))
        return CheckedDepth(depth, consistency, names, tuple(doubts))

    def _used(self, frame_set: FrameSet) -> tuple[str, ...]:
        """The auxiliaries with an image, those in doubt left out where others remain."""
        usable = usable_auxiliaries(self.rig, frame_set, self._auxiliaries)
        return tuple(n for n in usable if n not in self.left_out) or usable

    def _match(self, names: tuple[str, ...], frame_set: FrameSet, reporter: Reporter, prior: Any) -> DepthMap:
        key = tuple(n for n in self._auxiliaries if n not in self.left_out or n in names)
        key = key if set(names) == set(key) & set(frame_set.images) else names
        if key not in self._matchers:
            self._matchers[key] = self._matcher_of(key)
        matcher = self._matchers[key]
        if prior is None:
            return matcher.reconstruct(frame_set, reporter)
        return matcher.reconstruct(frame_set, reporter, prior=prior)

    def _check(self, frame_set: FrameSet, depth: DepthMap, names: tuple[str, ...]) -> RigConsistency:
        if self._allowance is None:
            middle = 2 / (1 / self._near_far[0] + 1 / self._near_far[1])
            self._allowance = allowance_of(self.rig, middle)
        return camera_consistency(frame_set, self.rig, depth, names, self._allowance)

    def _exchange(self, frame_set: FrameSet, consistency: RigConsistency) -> tuple[str, str] | None:
        """Two cameras exchanged; searched once for every set of doubtful cameras."""
        doubtful = consistency.doubtful
        if doubtful not in self._exchanged:
            self._exchanged[doubtful] = exchange_in_doubt(frame_set, self.rig, consistency)
        return self._exchanged[doubtful]

    def _marked(self, depth: DepthMap) -> DepthMap:
        if not self._systematic_px or not depth.measured.any():
            return depth
        return add_systematic_error(depth, self._systematic_px * depth_error_per_px(self.rig, depth))


def sequence_matcher(
    rig: Rig, cameras: Collection[str], depth_range_mm: tuple[float, float], settings: MultiviewSettings
) -> CheckedMatcher:
    """Return the matcher of a moving belt; its first frame is checked, and every `CHECK_EVERY`-th after it."""

    def matcher_of(names: tuple[str, ...]) -> MultiviewReconstructor:
        return MultiviewReconstructor(rig, depth_range_mm, settings, auxiliaries=names)

    auxiliaries = tuple(name for name in rig.auxiliaries if name in cameras)
    return CheckedMatcher(rig, auxiliaries, depth_range_mm, matcher_of, every=CHECK_EVERY)


def _trusted(consistency: RigConsistency) -> tuple[str, ...]:
    """The auxiliaries to measure with; none where the frame cannot say which."""
    if consistency.core_moved or consistency.ambiguous or not consistency.named("sound"):
        return ()
    return tuple(each.camera for each in consistency.cameras if each.camera not in consistency.doubtful)


def depth_error_per_px(rig: Rig, depth: DepthMap) -> float:
    """Return the depth error (mm) of a pixel of disparity at the map's median depth, over the mean baseline."""
    baseline = float(np.mean([np.linalg.norm(rig.cam_from_core[n].center_mm) for n in rig.auxiliaries]))
    middle = float(np.nanmedian(depth.depth_mm))
    return middle**2 / (float(rig.core_camera.focal_px.mean()) * baseline)


def add_systematic_error(depth: DepthMap, systematic_mm: float) -> DepthMap:
    """Return the map with an error that all pixels share in its σ."""
    sigma = np.hypot(depth.sigma_mm, np.float32(systematic_mm)).astype(np.float32)
    return replace(depth, sigma_mm=sigma, systematic_mm=systematic_mm)
