"""Distinct positions of the board among the frames of an adjusted rig: frames of a board at rest are one position."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult

SAME_POSITION = 0.02
"""Two frames show one position if the board's corners moved by less, RMS, than this share of the board's diagonal."""


def group_frames(adjustment: BundleAdjustmentResult) -> dict[int, int]:
    """Return frame index → number of its position, for the frames that the final adjustment used."""
    geometry = adjustment.geometry
    frames = np.unique(adjustment.bundle.observations.frame[adjustment.used])
    corners = geometry.points_mm @ geometry.board_rotation[frames].swapaxes(1, 2)
    corners = corners + geometry.board_translation_mm[frames][:, None]
    limit_mm = SAME_POSITION * float(np.linalg.norm(np.ptp(geometry.points_mm, axis=0)))
    group: NDArray[np.intp] = np.arange(len(frames))
    for i in range(1, len(frames)):
        moved_mm = np.sqrt(((corners[:i] - corners[i]) ** 2).sum(axis=2).mean(axis=1))
        joined = np.unique(group[np.append(np.flatnonzero(moved_mm < limit_mm), i)])
        group[np.isin(group, joined)] = joined[0]
    numbers = np.unique(group, return_inverse=True)[1]
    return {int(frame): int(number) for frame, number in zip(frames, numbers, strict=True)}
