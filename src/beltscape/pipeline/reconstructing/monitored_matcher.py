"""The matcher with the checks of the images: images that cannot be measured are not matched.

Windows are searched for dirt after the match.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.findings import Finding, summarise_faults
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.health.images.monitor import ImageCheck, ImageMonitor
from beltscape.pipeline.reconstructing.checked_matcher import CheckedMatcher, SequenceMatcher
from beltscape.pipeline.reconstructing.frame_measurements import (
    FrameMeasurements,
    ImageRequest,
    MeasurementRequest,
)
from beltscape.pipeline.reconstructing.pending_match import MatchPool, PendingMatch


@dataclass(frozen=True, slots=True, eq=False)
class PendingFrame:
    """A frame that is being matched ahead, with the cameras that will probably pass the checks of the images."""

    matcher: MonitoredMatcher
    frame_set: FrameSet
    cameras: frozenset[str]
    """Cameras whose images are matched."""
    match: PendingMatch | None
    """The match; None: it has not begun."""
    pool: MatchPool
    request: MeasurementRequest

    @property
    def is_done(self) -> bool:
        """Return whether `complete` need not wait for the match."""
        return self.match is None or self.match.depth.done()

    def find_measurements(
        self, depth: DepthMap | None
    ) -> tuple[MeasurementRequest, FrameMeasurements] | None:
        """Return what was measured of the frame with this depth, and the request; None: nothing."""
        return None if self.match is None else self.match.find_measurements(depth)

    def complete(self, reporter: Reporter) -> DepthMap:
        """Return the depth; see `MonitoredMatcher.reconstruct`. Frames are completed in their order."""
        return self.matcher.complete(self, reporter)


class MonitoredMatcher:
    """Checks the images of a frame before it is matched, and the windows' dirt after it."""

    def __init__(self, matcher: SequenceMatcher, monitor: ImageMonitor) -> None:
        self._matcher, self._monitor = matcher, monitor
        self._findings: tuple[Finding, ...] = ()
        self._is_whole = True
        self._reported: set[tuple[str, str]] = set()
        self._checked: tuple[str, ImageCheck] | None = None
        """Name and check of the next frame to be matched, where it was made already."""
        self._faults: frozenset[tuple[str, str]] | None = None
        """Check and camera of the faults of the images that were matched last; None: their frame gave no depth."""

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
        check = self._take_check(frame_set, None)
        return self._measure(frame_set, check, self._matcher.reconstruct, reporter)

    def check_repeat(self, frame_set: FrameSet, pending: PendingFrame | None, *, has_moved: bool) -> bool:
        """Check a frame's images; return whether they show only what the frame before showed, so that it may pass.

        ``has_moved``: the belt has moved since then, so that its images differ anyway. A frame may not pass whose
        images have other faults than those that were matched last, nor one before the references are learned. The
        next call, of `pass_over`, `reconstruct` or `complete`, is to be for this very frame.
        """
        if not self._monitor.checks_images or self._monitor.is_learning:
            return False
        check = self._take_check(frame_set, pending)
        self._checked = frame_set.frame, check
        shows_same = check.is_still or has_moved
        return shows_same and bool(check.frames.images) and _list_faults(check) == self._faults

    def pass_over(self, frame_set: FrameSet, reporter: Reporter) -> None:
        """Leave out the match of the frame that `check_repeat` checked; `findings` are then those of its images."""
        self._findings = self._take_check(frame_set, None).findings
        self._report(frame_set, self._findings, reporter)

    def _take_check(self, frame_set: FrameSet, pending: PendingFrame | None) -> ImageCheck:
        """Return the check of a frame's images, each frame's once."""
        checked, self._checked = self._checked, None
        if checked is not None and checked[0] == frame_set.frame:
            return checked[1]
        sampled = None if pending is None or pending.match is None else pending.match.find_images()
        return self._monitor.check_images(frame_set, sampled)

    def submit(self, frame_set: FrameSet, pool: MatchPool, request: MeasurementRequest) -> PendingFrame:
        """Begin to match a frame in a pool, and to measure in it what is requested and what its checks need.

        It is matched with the cameras that will probably pass the checks, which `complete` makes: they need the
        statistics of the images, which the pool computes. Where it will probably not be matched, nothing is begun.
        """
        assert isinstance(self._matcher, CheckedMatcher)
        expected, images = self._monitor.expect(), frame_set.images
        left_out = {name: image for name, image in images.items() if name in expected.left_out}
        matched = {name: image for name, image in images.items() if name not in left_out}
        match = None
        if expected.matches and matched and not request.is_repeat:
            asked = request
            if self._monitor.checks_images:
                asked = replace(request, images=ImageRequest(left_out, expected.window_cameras))
            match = self._matcher.submit(replace(frame_set, images=matched), pool, asked)
        return PendingFrame(self, frame_set, frozenset(matched), match, pool, request)

    def complete(self, pending: PendingFrame, reporter: Reporter) -> DepthMap:
        """Return the depth of a frame that was submitted; errors as `reconstruct`."""
        assert isinstance(self._matcher, CheckedMatcher)
        check = self._take_check(pending.frame_set, pending)
        cameras = check.frames.images.keys()
        if cameras and (pending.match is None or cameras != pending.cameras):
            match = self._matcher.submit(check.frames, pending.pool, pending.request)
            pending = replace(pending, match=match)
        complete = partial(self._matcher.reconstruct, pending=pending.match)
        return self._measure(pending.frame_set, check, complete, reporter, pending)

    def _measure(
        self,
        frame_set: FrameSet,
        check: ImageCheck,
        match: Callable[[FrameSet, Reporter], DepthMap],
        reporter: Reporter,
        pending: PendingFrame | None = None,
    ) -> DepthMap:
        self._findings, self._is_whole, self._faults = check.findings, check.is_whole, None
        self._report(frame_set, check.findings, reporter)
        faults = summarise_faults(one for one in check.findings if one.effect != "none")
        if faults and not check.frames.images:
            raise ReconstructionError(f"frame {frame_set.frame}: {faults}")
        try:
            # without a fault too few cameras gave an image, which the matcher names
            depth = match(check.frames if check.frames.images else frame_set, reporter)
        finally:
            self._findings = (*check.findings, *self._matcher.findings)
        self._faults = _list_faults(check)
        found = None if pending is None else pending.find_measurements(depth)
        dirt = self._monitor.check_depth(check, depth, None if found is None else found[1].light)
        self._report(frame_set, dirt, reporter)
        self._findings = (*self._findings, *dirt)
        return depth

    def _report(self, frame_set: FrameSet, findings: Sequence[Finding], reporter: Reporter) -> None:
        """Warn of the first fault of every check of every camera."""
        for one in findings:
            if one.is_fault and (one.check, one.subject) not in self._reported:
                self._reported.add((one.check, one.subject))
                reporter.warn(f"frame {frame_set.frame}: {one.text}")


def _list_faults(check: ImageCheck) -> frozenset[tuple[str, str]]:
    """Return check and camera of the faults that concern the records; warnings need no depth."""
    return frozenset(
        (one.check, one.subject) for one in check.findings if one.is_fault and one.effect != "none"
    )
