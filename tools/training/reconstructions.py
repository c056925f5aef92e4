"""The depth map that the matcher, as trained so far, gives of a training capture."""

from __future__ import annotations

from pathlib import Path

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.images import read_image
from beltscape.files.rig_json import read_rig
from beltscape.stereo.multiview.depth_range import find_depth_range
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings
from training.samples.augmentation import Images, read_simulated


def reconstruct_capture(folder: Path, preset: str = "standard") -> DepthMap | None:
    """Return the depth map of a capture's first frame; None where no surface is found."""
    capture = read_simulated(folder)
    try:
        return _reconstruct(capture.rig, capture.images, preset)
    except ReconstructionError:
        return None


def reconstruct_frame(folder: Path, name: str, preset: str) -> DepthMap:
    """Return the depth map of a frame of a capture.

    Raises
    ------
    ReconstructionError
        If no surface is found.
    """
    rig = read_rig(folder / "truth" / "rig.json")
    images = {camera: read_image(next((folder / camera).glob(f"{name}.*"))) for camera in rig.cameras}
    return _reconstruct(rig, images, preset)


def _reconstruct(rig: Rig, images: Images, preset: str) -> DepthMap:
    frame = FrameSet("000", images)
    near_far = find_depth_range(rig, frame, Silent())
    return MultiviewReconstructor(rig, near_far, MultiviewSettings.preset(preset)).reconstruct(
        frame, Silent()
    )
