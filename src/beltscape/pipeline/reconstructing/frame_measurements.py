"""What is measured in a frame beside its depth, wherever the frame is matched, and used when it is the frame's turn.

All of it depends on the images, the depth, the rig and the empty belt only, and on nothing of the sequence but what
the request holds. A request is a guess of what will be needed: what was not measured, or for another state of the
sequence, is measured by the process that needs it, by the same functions and with the same result.
"""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.rig import Rig
from beltscape.core.statistics import compute_median
from beltscape.health.belt.monitor import BareBeltHeights, measure_bare_belt
from beltscape.health.image_statistics import ImageSample, sample_images
from beltscape.health.images.belt_images import BeltImageSampler, BeltImageSamples, SampleRequest
from beltscape.health.images.obstruction import LightMap, compute_block_rays, sample_light
from beltscape.health.settings import BeltLimits
from beltscape.measure.belt.reference import EmptyBeltReference
from beltscape.measure.flow.meter import PreparedDepth, prepare_depth
from beltscape.stereo.consistency.check import ResidualAccumulator, check_consistency
from beltscape.stereo.consistency.rig_consistency import RigConsistency
from beltscape.stereo.consistency.tolerance import Tolerance
from beltscape.workers.transport import SharedObject

_COVERAGE_CHANGE = 0.08
"""Change of the coverage since the last passed check that is unusual; two moved auxiliaries of four change it by 0.04
on an empty belt and by 0.2 on material."""
_SIGMA_RATIO = 1.3
"""Ratio of the median σ to that of the last passed check that is unusual; one moved auxiliary of four gives 1.35."""
_COMPARED_STRIDE = 4
"""Rows and columns between the pixels that are compared."""


@dataclass(frozen=True, slots=True)
class DepthSummary:
    """Coverage and σ of a depth map."""

    coverage: float
    sigma_mm: float

    def differs(self, now: DepthSummary) -> bool:
        """Return whether another depth map is unusual beside this one, so that the cameras are checked."""
        return (
            abs(now.coverage - self.coverage) > _COVERAGE_CHANGE
            or not now.sigma_mm <= _SIGMA_RATIO * self.sigma_mm
        )


def summarise_depth(depth: DepthMap) -> DepthSummary:
    """Return the coverage and the median σ of a depth map."""
    sigma = depth.sigma_mm[::_COMPARED_STRIDE, ::_COMPARED_STRIDE]
    measured = np.isfinite(sigma)
    return DepthSummary(float(measured.mean()), compute_median(sigma[measured]))


@dataclass(frozen=True, slots=True, eq=False)
class CameraRequest:
    """The arguments of a check of the cameras beside the frame's own."""

    auxiliaries: tuple[str, ...]
    tolerance: Tolerance
    confirmed: RigConsistency | None
    """The last frame in which the wide search confirmed the rig."""
    accumulator: bytes
    """The `ResidualAccumulator` of the frames before, pickled: the sequence goes on with its own meanwhile."""
    checks: int
    """Number of frames that were added to it."""

    def holds_for(self, auxiliaries: tuple[str, ...], confirmed: RigConsistency | None) -> bool:
        """Return whether a check with these arguments has the result of the requested one."""
        return self.auxiliaries == auxiliaries and self.confirmed is confirmed


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredCameras:
    """The result of a check of the cameras."""

    consistency: RigConsistency
    accumulator: ResidualAccumulator | None = None
    """With this frame; None: a frame that is not sound by itself is not added."""
    together: RigConsistency | None = None
    """The contradiction that the frames show together, if they do."""


@dataclass(frozen=True, slots=True, eq=False)
class CamerasAhead:
    """A check of the cameras that was made where the frame was matched, and what it was made with."""

    request: CameraRequest
    measured: MeasuredCameras


@dataclass(frozen=True, slots=True, eq=False)
class ImageRequest:
    """What the checks of the images need of a frame."""

    left_out: Mapping[str, Image]
    """The images that are checked, but not matched."""
    window_cameras: tuple[str, ...] | None
    """Cameras whose light shows dirt on their windows; None: it is not searched."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasurementRequest:
    """What to measure in a frame."""

    reference: SharedObject[EmptyBeltReference]
    """What the frame is measured against."""
    limits: BeltLimits
    samples: SampleRequest | None
    """What to sample of the images; None: nothing."""
    ahead: int
    """Number of frames that were submitted before and are not measured yet."""
    images: ImageRequest | None = None
    """The checks of the images; None: they are not checked."""
    cameras: SharedObject[CameraRequest] | None = None
    """The check of the cameras; None: they are not checked."""
    usual: DepthSummary | None = None
    """The cameras are checked where the depth differs from this one; None: in any case."""
    is_repeat: bool = False
    """Whether the frame probably shows what the one before shows, and is not matched."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameMeasurements:
    """What was measured in a frame; None: not asked for."""

    prepared: PreparedDepth
    bare_belt: BareBeltHeights | None
    samples: BeltImageSamples | None
    images: Mapping[str, ImageSample] | None
    light: Mapping[str, LightMap] | None
    cameras: MeasuredCameras | None


class FrameMeasurer:
    """Measures in frames of one rig."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._sampler: BeltImageSampler | None = None
        self._rays: NDArray[np.float64] | None = None

    def measure(self, frame_set: FrameSet, depth: DepthMap, request: MeasurementRequest) -> FrameMeasurements:
        """Return what is requested of a frame with its depth."""
        reference, limits = request.reference.value, request.limits
        images = None
        if request.images is not None:
            images = sample_images({**frame_set.images, **request.images.left_out})
        return FrameMeasurements(
            prepare_depth(depth, reference),
            measure_bare_belt(depth, reference, limits) if limits.enabled else None,
            self._sample_images(frame_set, depth, request),
            images,
            self._sample_light(depth, request.images, images),
            self._check_cameras(frame_set, depth, request),
        )

    def _check_cameras(
        self, frame_set: FrameSet, depth: DepthMap, asked: MeasurementRequest
    ) -> MeasuredCameras | None:
        if asked.cameras is None or (asked.usual and not asked.usual.differs(summarise_depth(depth))):
            return None
        request = asked.cameras.value
        consistency = check_consistency(
            frame_set, self._rig, depth, request.auxiliaries, request.tolerance, request.confirmed
        )
        if not (consistency.is_sound and consistency.guided):
            return MeasuredCameras(consistency)
        accumulator = cast("ResidualAccumulator", pickle.loads(request.accumulator))
        accumulator.add(consistency.tie_points)
        return MeasuredCameras(consistency, accumulator, accumulator.assess())

    def _sample_images(
        self, frame_set: FrameSet, depth: DepthMap, request: MeasurementRequest
    ) -> BeltImageSamples | None:
        if request.samples is None:
            return None
        self._sampler = self._sampler or BeltImageSampler(self._rig)
        return self._sampler.sample(frame_set, depth, request.samples)

    def _sample_light(
        self, depth: DepthMap, request: ImageRequest | None, images: Mapping[str, ImageSample] | None
    ) -> dict[str, LightMap] | None:
        if request is None or request.window_cameras is None or images is None:
            return None
        levels = {name: images[name].statistics.level for name in request.window_cameras if name in images}
        self._rays = compute_block_rays(self._rig) if self._rays is None else self._rays
        return sample_light(levels, self._rig, self._rays, depth)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredDepth:
    """The depth of a frame, and what was measured with it; None: nothing."""

    depth: DepthMap
    measurements: FrameMeasurements | None = None
    gpu_failure: str = ""
    """Why the worker no longer uses its GPU; empty: it does, or has none."""
