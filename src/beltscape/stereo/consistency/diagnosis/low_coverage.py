"""Diagnosis of a frame with low coverage: the most likely cause according to its images."""

from __future__ import annotations

import numpy as np

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.check import LEAST_TIE_POINTS
from beltscape.stereo.consistency.rig_consistency import RigConsistency

_DARK = 12.0
"""An image is dark if 99 % of its pixels are below this level of 255."""
_FEW_TEXTURED = 100
"""With fewer textured points in the core's image, the scene has hardly any texture."""


def diagnose_low_coverage(
    frame_set: FrameSet,
    rig: Rig,
    consistency: RigConsistency,
    depth_range_mm: tuple[float, float],
    coverage: float,
) -> tuple[str, bool]:
    """Return a line about the cause, and whether no image fits the rig, so that the depth is unreliable."""
    start = f"frame {frame_set.frame}: only {coverage:.0%} of the pixels are measured"
    if not coverage:
        start = f"frame {frame_set.frame}: no surface found"
    image = frame_set.images[rig.core]
    bright = float(np.percentile(image[::4, ::4], 99)) * 255 / np.iinfo(image.dtype).max
    if bright < _DARK:
        return (
            f"{start}: {rig.core}'s image is dark (99 % of it below {bright:.0f} of 255); expose longer",
            False,
        )
    if consistency.textured_points < _FEW_TEXTURED:
        return (
            f"{start}: {rig.core}'s image has hardly any texture ({consistency.textured_points} textured points); "
            "is the speckle projector on and in focus, and the exposure long enough?"
        ), False
    near, far = consistency.found_depth_range_mm
    if near < 0.98 * depth_range_mm[0] or far > 1.02 * depth_range_mm[1]:
        return (
            f"{start}: its points lie {near:.0f} to {far:.0f} mm away, the depth range is {depth_range_mm[0]:.0f} to "
            f"{depth_range_mm[1]:.0f} mm; give a --depth-range that holds them"
        ), False
    searched = [each for each in consistency.cameras if each.searched >= LEAST_TIE_POINTS]
    if searched and not np.isfinite(near) and not any(each.state == "sound" for each in searched):
        return (
            f"{start}, and no auxiliary image shows {rig.core}'s {consistency.textured_points} textured points where "
            "the rig predicts them: the cameras moved or were exchanged, the rig is another's, the images are of "
            "different instants, or there is too much noise"
        ), True
    return f"{start}; is the speckle projector on, and the exposure long enough?", False
