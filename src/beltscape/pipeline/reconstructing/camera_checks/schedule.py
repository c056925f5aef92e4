"""Schedule of the camera checks of a sequence: periodically, and at once when a frame is unusual."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet

_LONGEST_S = 10.0
"""Longest time between two checks, for slow sequences."""
_LEAST_FRAMES = 2
"""Unusual frames are checked at least this number of frames apart: a changing scene costs no check per frame."""
_COVERAGE_CHANGE = 0.08
"""Change of the coverage since the last passed check that is unusual; two moved auxiliaries of four change it by 0.04
on an empty belt and by 0.2 on material."""
_SIGMA_RATIO = 1.3
"""Ratio of the median σ to that of the last passed check that is unusual; one moved auxiliary of four gives 1.35."""
_MOST_REPEATED = 8
"""Number of checks in a row that are made of successive frames while it is not known which camera moved: four frames
together nearly always show it."""
_STRIDE = 4
"""Rows and columns between the pixels that are compared."""


@dataclass(frozen=True, slots=True)
class _Summary:
    """Coverage and σ of a depth map."""

    coverage: float
    sigma_mm: float


class CheckSchedule:
    """Decides which frames of a sequence are checked; it depends on the frames only, not on the system's clock."""

    def __init__(self, every: int) -> None:
        """Every ``every``-th frame is checked at least."""
        self._every = every
        self._frames_since = every
        self._time_ns: int | None = None
        self._passed: _Summary | None = None
        self._repeated = 0

    def is_due(self, frame_set: FrameSet, depth: DepthMap | None) -> bool:
        """Return whether a frame must be checked; ``depth`` is None if it could not be matched."""
        self._frames_since += 1
        if self._frames_since >= self._every or self._is_late(frame_set):
            return True
        return self._frames_since >= _LEAST_FRAMES and self._is_unusual(depth)

    def note_check(
        self, frame_set: FrameSet, depth: DepthMap | None, *, has_passed: bool, is_undecided: bool = False
    ) -> None:
        """Account for a check; an unusual frame that passed is the usual one from now on.

        After an undecided check the next frame is due, some times in a row.
        """
        self._frames_since, self._time_ns = 0, frame_set.time_ns
        self._repeated = self._repeated + 1 if is_undecided else 0
        if 0 < self._repeated <= _MOST_REPEATED:
            self.request()
        if has_passed and depth is not None:
            self._passed = _measure(depth)

    def request(self) -> None:
        """Make the next frame due."""
        self._frames_since = self._every

    def _is_late(self, frame_set: FrameSet) -> bool:
        if frame_set.time_ns is None or self._time_ns is None:
            return False
        return frame_set.time_ns - self._time_ns >= _LONGEST_S * 1e9

    def _is_unusual(self, depth: DepthMap | None) -> bool:
        if depth is None or self._passed is None:
            return depth is None
        now, usual = _measure(depth), self._passed
        return (
            abs(now.coverage - usual.coverage) > _COVERAGE_CHANGE
            or not now.sigma_mm <= _SIGMA_RATIO * usual.sigma_mm
        )


def _measure(depth: DepthMap) -> _Summary:
    sigma = depth.sigma_mm[::_STRIDE, ::_STRIDE]
    measured = np.isfinite(sigma)
    return _Summary(
        float(measured.mean()), float(np.median(sigma[measured])) if measured.any() else float("nan")
    )
