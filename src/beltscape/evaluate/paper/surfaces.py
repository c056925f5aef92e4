"""Depth maps of every scene by every method, with their scores against the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter, Silent
from beltscape.evaluate.paper.laboratory import Laboratory, Scene
from beltscape.evaluate.scores.frame_score import RegionScore, score_frame
from beltscape.evaluate.truth.simulated import Truth
from beltscape.files.reconstruction import read_frame
from beltscape.pipeline.reconstructing.reconstruction import reconstruct_capture

METHODS = ("binocular", "pairwise", "multiview")
"""Pairwise is the paper's method, multiview Beltscape's, and binocular the paper's comparison."""
TITLES = {
    "binocular": "binocular",
    "pairwise": "the paper's method",
    "multiview": "Beltscape",
}
REGION = {"belt_empty": "belt", "belt_loaded": "material", "module": "module"}
"""Scene → region that is scored."""
FRAME = "000"


@dataclass(frozen=True, slots=True, eq=False)
class ScoredDepth:
    """A depth map of a scene with its scores."""

    scene: str
    by: str
    """Method or sensor."""
    folder: Path | None
    """Folder of the reconstructed frame; None if nothing could be measured."""
    depth: DepthMap
    truth: Truth
    """Truth on the depth map's grid."""
    scores: Mapping[str, RegionScore]

    @property
    def score(self) -> RegionScore:
        """Scores of the scene's main region."""
        return self.scores[REGION[base_scene(self.scene)]]

    @property
    def points(self) -> int:
        """Number of measured pixels of that region."""
        return round(self.score.depth.coverage * self.score.depth.pixels)

    @property
    def right_points(self) -> int:
        """Number of pixels of that region within 1 mm of the truth."""
        return round(self.score.depth.within_1mm * self.score.depth.pixels)


Surfaces = Mapping[tuple[str, str], ScoredDepth]
"""Depth maps and scores by scene and method."""


def base_scene(scene: str) -> str:
    """Return a scene's name without the suffix of captures without speckle."""
    return scene.removesuffix("_nospeckle")


def reconstruct_all(lab: Laboratory, rig: Rig, out: Path, reporter: Reporter) -> Surfaces:
    """Reconstruct every scene by every method and write it to ``out`` / method / scene.

    Without speckle the depth range of the capture with speckle is used, because an empty belt does not show one.
    """
    jobs = [(scene, method) for scene in lab.scenes.values() for method in METHODS]
    found: dict[tuple[str, str], ScoredDepth] = {}
    ranges: dict[str, Range | None] = {}
    reporter.step("reconstructing", 0, len(jobs))
    for number, (scene, method) in enumerate(jobs):
        near_far = ranges.get(scene.kind)
        found[scene.name, method], ranges[scene.kind] = _reconstruct(scene, method, rig, out, near_far)
        reporter.step("reconstructing", number + 1, len(jobs))
    return found


def score_surface(scene: Scene, by: str, folder: Path | None, depth: DepthMap, rig: Rig) -> ScoredDepth:
    """Return a depth map with its scores."""
    truth = scene.truth.resample_to(rig)
    return ScoredDepth(scene.name, by, folder, depth, truth, score_frame(depth, rig, scene.truth))


def make_empty_depth_map(rig: Rig) -> DepthMap:
    """Return a depth map of the rig's core without measured pixels."""
    empty = np.full(rig.core_camera.size_px[::-1], np.nan, np.float32)
    zero = np.zeros(empty.shape)
    return DepthMap(empty, empty, zero.astype(np.uint8), zero.astype(np.float32))


Range = tuple[float, float]


def _reconstruct(
    scene: Scene, method: str, rig: Rig, out: Path, near_far: Range | None
) -> tuple[ScoredDepth, Range | None]:
    folder = out / method / scene.name
    try:
        done = reconstruct_capture(
            scene.capture, rig, folder, Silent(), method=method, depth_range_mm=near_far
        )
    except ReconstructionError:
        return score_surface(scene, method, None, make_empty_depth_map(rig), rig), near_far
    frame = folder / FRAME
    return score_surface(scene, method, frame, read_frame(frame).depth, rig), done.depth_range_mm
