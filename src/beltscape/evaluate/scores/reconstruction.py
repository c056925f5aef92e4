"""Scores of all frames of a reconstruction against their truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter
from beltscape.evaluate.scores.frame_score import RegionScore, score_frame
from beltscape.evaluate.truth.simulated import WITHIN_MM, TruthFile
from beltscape.files.reconstruction import list_frame_folders, read_frame


def score_reconstruction(
    folder: Path, truth: TruthFile, reporter: Reporter, *, within_mm: float = WITHIN_MM
) -> Mapping[str, Mapping[str, RegionScore]]:
    """Return the scores by frame and region of a reconstruction ``DIR`` or one frame folder ``DIR/<frame>``.

    Raises
    ------
    InputError
        When the folder contains no frame, or a frame has no truth.
    """
    frames = list_frame_folders(folder)
    if not frames:
        raise InputError(f"{folder}: no frame with depth.tiff in it; give a folder of beltscape reconstruct")
    scores: dict[str, Mapping[str, RegionScore]] = {}
    for number, frame in enumerate(frames):
        result = read_frame(frame)
        scores[frame.name] = score_frame(
            result.depth, result.rig, truth.for_frame(frame.resolve().name), within_mm=within_mm
        )
        reporter.step("against the truth", number + 1, len(frames))
    return scores
