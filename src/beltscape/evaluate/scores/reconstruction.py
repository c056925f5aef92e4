"""Scores of all frames of a reconstruction against their truth, whatever method it is by."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.evaluate.scores.frame_score import RegionScore, score_frame
from beltscape.evaluate.truth.simulated import WITHIN_MM, Truth, TruthFile
from beltscape.files.reconstruction import find_rig_file, list_frame_folders, read_depth_map
from beltscape.files.rig_json import read_rig


def score_reconstruction(
    folder: Path, truth: TruthFile, reporter: Reporter, *, within_mm: float = WITHIN_MM
) -> Mapping[str, Mapping[str, RegionScore]]:
    """Return the scores by frame and region of a reconstruction ``DIR``, a frame folder in it, or one depth.tiff.

    Of a frame only depth.tiff is needed. Without rig.json beside it, it lies on the truth's own grid; without
    sigma.tiff, the scores of σ are NaN.

    Raises
    ------
    InputError
        When the folder contains no frame, or a frame has no truth.
    """
    frames = [folder] if folder.is_file() else list_frame_folders(folder)
    if not frames:
        raise InputError(
            f"{folder}: no frame with depth.tiff in it; give a folder of beltscape reconstruct or bs.write_depth"
        )
    scores: dict[str, Mapping[str, RegionScore]] = {}
    for number, frame in enumerate(frames):
        named = frame.resolve().parent.name if frame.is_file() else frame.resolve().name
        true = truth.for_frame(named)
        depth, rig = _read_frame(frame, true)
        scores[named] = score_frame(depth, rig, true, within_mm=within_mm)
        reporter.step("against the truth", number + 1, len(frames))
    return scores


def _read_frame(frame: Path, truth: Truth) -> tuple[DepthMap, Rig]:
    """Return a frame's depth map and the rig on whose core grid it lies; InputError where their sizes differ."""
    depth, path = read_depth_map(frame), find_rig_file(frame)
    rig = read_rig(path) if path.is_file() and truth.is_placed else truth.rig
    width, height = rig.core_camera.size_px
    if depth.depth_mm.shape != (height, width):
        own = f"{depth.depth_mm.shape[1]}×{depth.depth_mm.shape[0]}"
        of = path if rig is not truth.rig else "the truth"
        raise InputError(
            f"{frame}: {own} px, but the core camera of {of} has {width}×{height}; give depths on its "
            "undistorted grid, or the rig.json of another beside them"
        )
    return depth, rig
