"""A matcher whose frames pass the checks of images: what cannot be measured is not matched."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.live.findings import Finding, summarise_faults
from beltscape.core.progress import Reporter
from beltscape.health.images.monitor import ImageMonitor


class SequenceMatcher(Protocol):
    """Reconstructs frame after frame; the depth depends on a frame's images and on the cameras in use."""

    @property
    def is_inconsistent(self) -> bool:
        """Return whether cameras contradict the rig; the belt in such frames counts as degraded."""
        ...

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Return the findings about the cameras in the last frame, also if it could not be reconstructed."""
        ...

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        """Return the depth of a frame; ReconstructionError if its images do not suffice."""
        ...


class MonitoredMatcher:
    """Checks the images of a frame before it is matched, and the windows' dirt after it."""

    def __init__(self, matcher: SequenceMatcher, monitor: ImageMonitor) -> None:
        self._matcher, self._monitor = matcher, monitor
        self._findings: tuple[Finding, ...] = ()
        self._is_whole = True
        self._reported: set[tuple[str, str]] = set()

    @property
    def is_inconsistent(self) -> bool:
        """Return whether cameras contradict the rig, or one was left out of the last frame."""
        return self._matcher.is_inconsistent or not self._is_whole

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Return the findings about images and cameras of the last frame, also if it was not matched."""
        return self._findings

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        """Return the depth of a frame from the cameras that passed the checks.

        Raises
        ------
        ReconstructionError
            When the checks leave nothing to match, or the images do not suffice.
        """
        check = self._monitor.check_images(frame_set)
        self._findings, self._is_whole = check.findings, check.is_whole
        self._report(frame_set, check.findings, reporter)
        faults = summarise_faults(one for one in check.findings if one.effect != "none")
        if faults and not check.frames.images:
            raise ReconstructionError(f"frame {frame_set.frame}: {faults}")
        try:
            # without a fault too few cameras gave an image, which the matcher names
            frames = check.frames if check.frames.images else frame_set
            depth = self._matcher.reconstruct(frames, reporter)
        finally:
            self._findings = (*check.findings, *self._matcher.findings)
        dirt = self._monitor.check_depth(depth)
        self._report(frame_set, dirt, reporter)
        self._findings = (*self._findings, *dirt)
        return depth

    def _report(self, frame_set: FrameSet, findings: Sequence[Finding], reporter: Reporter) -> None:
        """Warn of the first fault of every check of every camera."""
        for one in findings:
            if one.is_fault and (one.check, one.subject) not in self._reported:
                self._reported.add((one.check, one.subject))
                reporter.warn(f"frame {frame_set.frame}: {one.text}")
