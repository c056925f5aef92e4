"""The key frame: the frame with which those after it are registered."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from beltscape.core.live.findings import worst_effect
from beltscape.measure.flow.motion.plausibility import is_unmatched
from beltscape.measure.flow.motion.pushed_frame import PushedFrame
from beltscape.measure.flow.motion.registration.high_pass import HighPassHeights
from beltscape.measure.flow.motion.registration.shift import Shift, register

_USUAL_SCORES = 16
"""Number of latest correlations that are kept as the usual ones."""
_LEAST_UNMATCHED = 2
"""Number of frames without a match after which the encoder's prediction is wrong; one frame may be bad itself."""


class KeyFrame:
    """Heights of the key frame; replaced as the belt moves."""

    def __init__(self, least_overlap: float) -> None:
        self.heights: HighPassHeights | None = None
        """None: no frame yet, or one without a depth map."""
        self.number = 0
        self._least_overlap = least_overlap
        self._scores: deque[float] = deque(maxlen=_USUAL_SCORES)
        self._unmatched = 0

    @property
    def has_load(self) -> bool:
        """Return whether the key frame has enough load for registration."""
        return self.heights is not None and self.heights.has_load

    def replace(self, frame: PushedFrame) -> None:
        """Make a frame the key frame."""
        self.heights, self.number = frame.high_pass, frame.number

    def register(self, heights: HighPassHeights, near_mm: float | None) -> Shift | None:
        """Return the motion of the material since the key frame; ``near_mm`` is the prediction along y."""
        if self.heights is None:
            return None
        return register(self.heights, heights, least_overlap=self._least_overlap, near_mm=near_mm)

    def leave_out(self, number: int, cells: NDArray[np.bool_], noise_mm: float) -> None:
        """Leave cells (Ny, Nx) that are no load out of the key frame, if it is frame ``number``."""
        if self.heights is not None and self.number == number:
            self.heights = self.heights.leave_out(cells, noise_mm)

    def add_match(self, score: float) -> None:
        """Note the correlation of a frame that matches."""
        self._scores.append(score)

    def is_unmatched(self, frame: PushedFrame, near_mm: float) -> bool:
        """Return whether the material of a sound frame is not where a motion ``near_mm`` along y puts it."""
        if self.heights is None or frame.high_pass is None or worst_effect(frame.findings) != "none":
            return False
        return is_unmatched(
            self.heights,
            frame.high_pass,
            near_mm,
            least_overlap=self._least_overlap,
            usual_scores=self._scores,
        )

    def reset_unmatched(self) -> None:
        """Note that a frame matches."""
        self._unmatched = 0

    def count_unmatched(self) -> bool:
        """Count a frame that does not match; return whether their number contradicts the prediction."""
        self._unmatched = (self._unmatched + 1) % _LEAST_UNMATCHED
        return self._unmatched == 0
