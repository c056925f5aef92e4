"""The depth map that the matcher, as trained so far, gives of a training capture."""

from __future__ import annotations

from pathlib import Path

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.stereo.multiview.depth_range import find_depth_range
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings
from training.samples.augmentation import read_simulated


def reconstruct_capture(folder: Path, preset: str = "standard") -> DepthMap | None:
    """Return the depth map of a capture's first frame; None where no surface is found."""
    capture = read_simulated(folder)
    frame = FrameSet("000", capture.images)
    try:
        near_far = find_depth_range(capture.rig, frame, Silent())
    except ReconstructionError:
        return None
    matcher = MultiviewReconstructor(capture.rig, near_far, MultiviewSettings.preset(preset))
    return matcher.reconstruct(frame, Silent())
