"""Depth maps of every scene by every method, with their scores against the truth.

Fig. 16 is the gain in measured points by the projected speckle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter, Silent
from beltscape.evaluate.frame_scores import RegionScore, score_frame
from beltscape.evaluate.paper.laboratory import Laboratory, LaboratoryScene
from beltscape.evaluate.truth import Truth
from beltscape.files.reconstruction import read_frame
from beltscape.pipeline.reconstructing.reconstruction import reconstruct_capture
from beltscape.workers.options import HERE, WorkerOptions
from beltscape.workers.tasks import collect_values

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


def reconstruct_all(
    lab: Laboratory, rig: Rig, out: Path, reporter: Reporter, workers: WorkerOptions = HERE
) -> Surfaces:
    """Reconstruct every scene by every method and write it to ``out`` / method / scene.

    Without speckle the depth range of the capture with speckle is used, because an empty belt does not show one: the
    first surfaces of every kind of scene are reconstructed before the others.
    """
    laboratory = _Reconstructed(
        {name: scene.without_caches() for name, scene in lab.scenes.items()}, rig, out
    )
    jobs = [(scene.name, method) for scene in lab.scenes.values() for method in METHODS]
    found: dict[tuple[str, str], ScoredDepth] = {}

    def run(series: list[_Series]) -> None:
        before = len(found)
        step = sum(len(one.jobs) for one in series) / max(len(series), 1)
        ends = collect_values(
            _reconstruct_series, laboratory, series, workers,
            lambda done: reporter.step("reconstructing", before + round(done * step), len(jobs)),
        )  # fmt: skip
        for one, (surfaces, near_far) in zip(series, ends, strict=True):
            found.update(zip(one.jobs, surfaces, strict=True))
            ranges[lab.scenes[one.jobs[0][0]].kind] = near_far

    ranges: dict[str, Range | None] = {}
    kinds = {
        scene.kind: [job for job in jobs if lab.scenes[job[0]].kind == scene.kind]
        for scene in lab.scenes.values()
    }
    run([_Series((of_kind[0],), None) for of_kind in kinds.values()])
    run([one for kind, of_kind in kinds.items() for one in _list_series(of_kind[1:], ranges[kind])])
    return {job: found[job] for job in jobs}


def score_surface(
    scene: LaboratoryScene, by: str, folder: Path | None, depth: DepthMap, rig: Rig
) -> ScoredDepth:
    """Return a depth map with its scores."""
    truth = scene.truth.resample_to(rig)
    return ScoredDepth(scene.name, by, folder, depth, truth, score_frame(depth, rig, scene.truth))


def make_empty_depth_map(rig: Rig) -> DepthMap:
    """Return a depth map of the rig's core without measured pixels."""
    empty = np.full(rig.core_camera.size_px[::-1], np.nan, np.float32)
    zero = np.zeros(empty.shape)
    return DepthMap(empty, empty, zero.astype(np.uint8), zero.astype(np.float32))


Range = tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class _Reconstructed:
    """Settings and inputs that all reconstructions share."""

    scenes: Mapping[str, LaboratoryScene]
    rig: Rig
    out: Path


@dataclass(frozen=True, slots=True)
class _Series:
    """Surfaces that are reconstructed one after the other."""

    jobs: tuple[tuple[str, str], ...]
    """Scene and method of each."""
    near_far: Range | None
    """Their depth range; None: that which the first of them finds."""


def _list_series(jobs: Sequence[tuple[str, str]], near_far: Range | None) -> list[_Series]:
    """Return surfaces of one kind of scene: each by itself, or all in turn where a depth range is to be found."""
    if near_far is not None:
        return [_Series((job,), near_far) for job in jobs]
    return [_Series(tuple(jobs), None)] if jobs else []


def _reconstruct_series(shared: _Reconstructed, series: _Series) -> tuple[list[ScoredDepth], Range | None]:
    found: list[ScoredDepth] = []
    near_far = series.near_far
    for scene, method in series.jobs:
        one, near_far = _reconstruct(shared.scenes[scene], method, shared.rig, shared.out, near_far)
        found.append(one)
    return found, near_far


def _reconstruct(
    scene: LaboratoryScene, method: str, rig: Rig, out: Path, near_far: Range | None
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


@dataclass(frozen=True, slots=True, eq=False)
class DensityComparison:
    """One scene and method, with the projector on and off."""

    speckle: ScoredDepth
    dark: ScoredDepth

    @property
    def ratio(self) -> float:
        """Measured points with speckle over without, on the surface that the scene is about; inf over none."""
        return _ratio(self.speckle.points, self.dark.points)

    @property
    def right_ratio(self) -> float:
        """The ratio for the points within 1 mm of the truth."""
        return _ratio(self.speckle.right_points, self.dark.right_points)


def compute_density_gains(surfaces: Surfaces) -> tuple[DensityComparison, ...]:
    """Return the gain of every scene and method with both captures."""
    pairs = [((scene, method), (f"{scene}_nospeckle", method)) for scene in REGION for method in METHODS]
    return tuple(
        DensityComparison(surfaces[on], surfaces[off])
        for on, off in pairs
        if on in surfaces and off in surfaces
    )


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else np.inf
