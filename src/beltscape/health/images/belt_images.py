"""Checks of images against the measured surface and the belt's motion: synchronisation, position of the projector."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.health.images.projector_position import LearnedPattern, ProjectorMonitor
from beltscape.health.images.surface_samples import SurfaceGrid
from beltscape.health.images.synchronisation_monitor import SynchronisationMonitor
from beltscape.health.settings import HealthSettings
from beltscape.measure.belt.reference import EmptyBeltReference


class BeltImageMonitor:
    """Compares the images of successive frames with the surface and the motion that were measured in them."""

    def __init__(
        self,
        rig: Rig,
        reference: EmptyBeltReference,
        settings: HealthSettings,
        pattern: LearnedPattern | None = None,
        keep_pattern: Callable[[LearnedPattern], None] | None = None,
    ) -> None:
        """``pattern`` is that of the projector by an earlier run; ``keep_pattern`` receives a learned one."""
        self._settings = settings
        grid = SurfaceGrid(rig)
        self._projector = ProjectorMonitor(rig, reference, settings, pattern, keep_pattern, grid)
        self._synchronisation = SynchronisationMonitor(rig, settings, grid)

    def learn_anew(self) -> None:
        """Forget the projector's pattern, before the next frame is checked; any thread may call it."""
        self._projector.learn_anew()

    def check_projector(
        self, frames: FrameSet, depth: DepthMap | None, findings: Sequence[Finding]
    ) -> tuple[Finding, ...]:
        """Return the finding about the projector's position; ``findings`` are those about its images and cameras."""
        if not self._settings.images:
            return ()
        return self._projector.check(frames, depth, findings)

    def check_synchronisation(
        self,
        frames: FrameSet,
        depth: DepthMap | None,
        position_mm: float | None,
        along: NDArray[np.float64] | None,
        findings: Sequence[Finding],
    ) -> tuple[Finding, ...]:
        """Return the findings about the cameras' instants, once the frame's position on the belt is known.

        ``along`` (3,) is the direction of travel in the core's frame; None: not known. ``findings`` are those about
        the frame's images and cameras.
        """
        if not self._settings.images:
            return ()
        return self._synchronisation.check(frames, depth, position_mm, along, findings)
