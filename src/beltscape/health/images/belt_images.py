"""Checks of images against the measured surface and the belt's motion: synchronisation, position of the projector."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.health.images.projector_position import (
    BareBelt,
    BareBeltSampler,
    LearnedPattern,
    ProjectorMonitor,
)
from beltscape.health.images.surface_samples import SurfaceGrid, SurfaceSamples
from beltscape.health.images.synchronisation_monitor import SynchronisationMonitor
from beltscape.health.settings import HealthSettings
from beltscape.measure.belt.reference import EmptyBeltReference
from beltscape.workers.calls import CallMaker
from beltscape.workers.transport import SharedObject


@dataclass(frozen=True, slots=True, eq=False)
class SampleRequest:
    """What the checks will probably need of a frame."""

    surface: bool
    """Whether the synchronisation is checked."""
    belt: bool
    """Whether the projector is."""
    pattern: SharedObject[LearnedPattern | None]
    """The learned pattern of the projector; None: it is being learned."""
    reference: SharedObject[EmptyBeltReference]
    """The learned empty belt."""


@dataclass(frozen=True, slots=True, eq=False)
class BeltImageSamples:
    """What was sampled of one frame; None: nothing."""

    surface: SurfaceSamples | None
    belt: BareBelt | None


class BeltImageSampler:
    """Samples frames of one rig for the checks; the samples depend on a frame's images and its depth only."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._grid = SurfaceGrid(rig)
        self._belt: tuple[EmptyBeltReference, BareBeltSampler] | None = None

    def sample(self, frames: FrameSet, depth: DepthMap, request: SampleRequest) -> BeltImageSamples:
        """Return what is requested of a frame."""
        view, belt = self._grid.view(frames, depth), None
        if request.belt:
            belt = self._choose_sampler(request.reference.value).sample(view, request.pattern.value)
        return BeltImageSamples(view.sample_surface(self._rig.cameras) if request.surface else None, belt)

    def _choose_sampler(self, reference: EmptyBeltReference) -> BareBeltSampler:
        if self._belt is None or self._belt[0] is not reference:
            self._belt = reference, BareBeltSampler(self._rig, reference, self._grid)
        return self._belt[1]


class BeltImageMonitor:
    """Compares the images of successive frames with the surface and the motion that were measured in them."""

    def __init__(
        self,
        rig: Rig,
        reference: EmptyBeltReference,
        settings: HealthSettings,
        pattern: LearnedPattern | None = None,
        keep_pattern: Callable[[LearnedPattern], None] | None = None,
        calls: CallMaker | None = None,
    ) -> None:
        """``pattern`` is that of the projector by an earlier run; ``keep_pattern`` receives a learned one.

        ``calls`` compares frames beside the thread that measures; None: this thread does.
        """
        self._rig, self._settings = rig, settings
        self._reference = SharedObject(reference)
        self._pattern: SharedObject[LearnedPattern | None] = SharedObject(pattern)
        self._grid = SurfaceGrid(rig)
        self._projector = ProjectorMonitor(rig, reference, settings, pattern, keep_pattern, self._grid)
        self._synchronisation = SynchronisationMonitor(rig, settings, self._grid, calls)

    def learn_anew(self) -> None:
        """Forget the projector's pattern, before the next frame is checked; any thread may call it."""
        self._projector.learn_anew()

    def expect(self, frames: FrameSet, ahead: int) -> SampleRequest | None:
        """Return what the checks will probably need of a frame set, before which ``ahead`` others are checked.

        It may be sampled meanwhile by a `BeltImageSampler`. It is asked of the frame sets in their order.
        """
        if not self._settings.images:
            return None
        surface, belt = self._synchronisation.expects(frames, ahead), self._projector.expects(frames)
        if not (surface or belt):
            return None
        if self._pattern.value is not self._projector.learned:
            self._pattern = SharedObject(self._projector.learned)
        return SampleRequest(surface, belt, self._pattern, self._reference)

    def adopt(
        self, frames: FrameSet, depth: DepthMap, request: SampleRequest, samples: BeltImageSamples
    ) -> BareBelt | None:
        """Use what was sampled of a frame for a request, as far as it holds; return what holds for the projector."""
        if samples.surface is not None:
            self._grid.keep(frames, depth, samples.surface)
        belt = samples.belt
        names = tuple(name for name in self._rig.cameras if name in frames.images)
        holds = (
            belt is not None and request.pattern.value is self._projector.learned and belt.cameras == names
        )
        return belt if holds else None

    def check_projector(
        self,
        frames: FrameSet,
        depth: DepthMap | None,
        findings: Sequence[Finding],
        sampled: BareBelt | None = None,
    ) -> tuple[Finding, ...]:
        """Return the finding about the projector's position; ``findings`` are those about its images and cameras.

        ``sampled`` is what `adopt` returned for this frame.
        """
        if not self._settings.images:
            return ()
        return self._projector.check(frames, depth, findings, sampled)

    def begin_synchronisation(
        self,
        frames: FrameSet,
        depth: DepthMap | None,
        position_mm: float | None,
        along: NDArray[np.float64] | None,
        findings: Sequence[Finding],
    ) -> None:
        """Begin to check the cameras' instants, once the frame's position on the belt is known.

        ``along`` (3,) is the direction of travel in the core's frame; None: not known. ``findings`` are those about
        the frame's images and cameras.
        """
        if self._settings.images:
            self._synchronisation.begin(frames, depth, position_mm, along, findings)

    def complete_synchronisation(self) -> tuple[Finding, ...]:
        """Return the findings about the cameras' instants in the frame that was begun last."""
        return self._synchronisation.complete() if self._settings.images else ()
