"""All experiments of the paper's section 3: calibrate, reconstruct, measure and compare."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.evaluate.depth_scores import RigScore, score_rig_against_truth
from beltscape.evaluate.paper.dimensions import (
    PLAIN,
    DimensionRow,
    MeasuredDimensions,
    PaperNumbers,
    measure_features,
    read_core_image,
    read_paper_numbers,
    tabulate_dimensions,
)
from beltscape.evaluate.paper.laboratory import Laboratory
from beltscape.evaluate.paper.other_sensors import (
    BASELINES,
    SPEED_MM_S,
    measure_baselines,
    measure_moving_belt,
    measure_time_of_flight,
    smooth_depth,
)
from beltscape.evaluate.paper.surfaces import (
    METHODS,
    DensityComparison,
    ScoredDepth,
    Surfaces,
    compute_density_gains,
    reconstruct_all,
)
from beltscape.kernels import load_on_processor
from beltscape.pipeline.calibrating.calibration import calibrate
from beltscape.pipeline.calibrating.calibration_files import write_calibration
from beltscape.target.board import read_board
from beltscape.target.module import read_module
from beltscape.workers.options import HERE, WorkerOptions

TRAVELS_MM = (0.0, 0.1, 1.0, 10.0)
"""Belt travel between two structured-light images; at 1 m/s 10,000, 1000 and 100 images per second."""
BASELINE_SCENES = ("belt_loaded", "module")


@dataclass(frozen=True, slots=True, eq=False)
class Paper:
    """All results of the experiments."""

    numbers: PaperNumbers
    laboratory: Laboratory
    rig: Rig
    """The calibrated rig, used by all methods except the baselines."""
    rig_score: RigScore
    surfaces: Surfaces
    density: tuple[DensityComparison, ...]
    dimensions: tuple[DimensionRow, ...]
    """Dimensions by every method, time of flight and baseline; empty without the module."""
    tof: ScoredDepth | None
    baselines: Mapping[tuple[str, str], ScoredDepth]
    moving: tuple[ScoredDepth, ...]
    """Structured light for `TRAVELS_MM`; empty if the scene cannot be rendered again."""
    seconds: Mapping[str, float]
    """Duration of each stage."""
    warnings: tuple[str, ...]

    @property
    def scenes(self) -> tuple[str, ...]:
        """Names of the scenes with speckle, in the paper's order."""
        return tuple(
            name for name in ("belt_empty", "belt_loaded", "module") if name in self.laboratory.scenes
        )


def evaluate_paper(
    lab: Laboratory, out: Path, seed: int, reporter: Reporter, workers: WorkerOptions = HERE
) -> Paper:
    """Run all experiments for which captures exist and write the results to ``out``.

    Reconstructions and simulated sensors run on ``workers``, which write to the same folders; the results are the
    same with any number of them.

    Raises
    ------
    InputError, CalibrationError, ReconstructionError, OutputError
        With one line that names the fault and the fix.
    """
    clock = _Clock()
    calibration = calibrate(lab.calibration, read_board(lab.board), None, reporter)
    write_calibration(out / "calibration", calibration)
    rig = calibration.rig
    truth = next(iter(lab.scenes.values())).truth
    clock.lap("calibration")
    surfaces = reconstruct_all(lab, rig, out, reporter, workers)
    clock.lap("reconstruction")
    tof = measure_time_of_flight(lab.scenes["module"]) if "module" in lab.scenes else None
    seen = {name: lab.scenes[name] for name in BASELINE_SCENES if name in lab.scenes}
    baselines = measure_baselines(seen, out, seed, reporter, workers)
    moving = _measure_moving(lab, baselines, seed, reporter, workers)
    clock.lap("other sensors")
    numbers = read_paper_numbers()
    measured = _measure_dimensions(lab, rig, surfaces, tof, baselines, reporter)
    clock.lap("dimensions")
    return Paper(
        numbers=numbers,
        laboratory=lab,
        rig=rig,
        rig_score=score_rig_against_truth(rig, truth.rig, load_on_processor()),
        surfaces=surfaces,
        density=compute_density_gains(surfaces),
        dimensions=tabulate_dimensions(numbers.dimension, measured) if measured else (),
        tof=tof,
        baselines=baselines,
        moving=moving,
        seconds=clock.laps,
        warnings=(*calibration.warnings, *_describe_omissions(lab)),
    )


def _measure_moving(
    lab: Laboratory,
    baselines: Mapping[tuple[str, str], ScoredDepth],
    seed: int,
    reporter: Reporter,
    workers: WorkerOptions,
) -> tuple[ScoredDepth, ...]:
    """Return structured light of the moving loaded belt; the belt at rest is measured with the baselines."""
    loaded = lab.scenes.get("belt_loaded")
    if loaded is None or loaded.simulation is None:
        return ()
    rest = baselines[loaded.name, BASELINES[0].name]
    return (rest, *measure_moving_belt(loaded, TRAVELS_MM[1:], seed, reporter, workers))


def _measure_dimensions(
    lab: Laboratory,
    rig: Rig,
    surfaces: Surfaces,
    tof: ScoredDepth | None,
    baselines: Mapping[tuple[str, str], ScoredDepth],
    reporter: Reporter,
) -> Mapping[str, MeasuredDimensions]:
    """Return the module's dimensions by method; empty without the module.

    As in the paper, its method, binocular and the sensors use only their points; Beltscape also uses the matched
    image, and structured light an image under even light.
    """
    if "module" not in lab.scenes:
        return {}
    module, true_rig = read_module(lab.module), lab.scenes["module"].truth.rig
    pattern, plain = (read_core_image(lab, name, rig.core_camera) for name in ("module", "module_nospeckle"))
    even = read_core_image(lab, "module_nospeckle", true_rig.core_camera)
    found = {method: surfaces["module", method] for method in METHODS}
    jobs = {
        method: partial(measure_features, found[method], rig, module) for method in ("binocular", "pairwise")
    }
    jobs["multiview"] = partial(measure_features, found["multiview"], rig, module, pattern=pattern)
    if plain is not None:
        jobs[PLAIN] = partial(measure_features, found["multiview"], rig, module, pattern=pattern, plain=plain)
    if tof is not None:
        jobs[tof.by] = partial(measure_features, smooth_depth(tof), tof.truth.rig, module)
    for baseline in BASELINES:
        if ("module", baseline.name) in baselines:
            image = even if baseline.has_even_image else None
            jobs[baseline.name] = partial(
                measure_features, baselines["module", baseline.name], true_rig, module, plain=image
            )
    measured: dict[str, MeasuredDimensions] = {}
    for by, job in jobs.items():
        reporter.step("measuring the module", len(measured), len(jobs))
        measured[by] = job()
    reporter.step("measuring the module", len(jobs), len(jobs))
    return measured


def _describe_omissions(lab: Laboratory) -> tuple[str, ...]:
    """Return warnings of the experiments that are impossible with these captures."""
    if all(scene.simulation is not None for scene in lab.scenes.values()):
        return ()
    return (
        "these captures have no truth/scenario.json: structured light, line laser, LiDAR and time of flight are left "
        "out, as the scenes cannot be rendered again",
    )


def make_paper_document(paper: Paper) -> Mapping[str, Any]:
    """Return the results as plain values for JSON."""
    found = [*paper.surfaces.values(), *paper.baselines.values(), *([paper.tof] if paper.tof else [])]
    return {
        "source": paper.numbers.source,
        "rig_against_truth": asdict(paper.rig_score),
        "dimensions": [
            {
                "name": row.dimension.name,
                "row": row.dimension.row,
                "actual_mm": row.dimension.actual_mm,
                "paper_table2_mm": row.dimension.table2_mm,
                "paper_table3_mm": row.dimension.table3_mm,
                "measured_mm": row.measured_mm,
                "sigma_mm": row.sigma_mm,
            }
            for row in paper.dimensions
        ],
        "depth": [
            {"scene": one.scene, "by": one.by, "folder": one.folder, "points": one.points, **one.score.document()}
            for one in found
        ],
        "density": [
            {
                "scene": one.speckle.scene,
                "method": one.speckle.by,
                "points": one.speckle.points,
                "points_without_speckle": one.dark.points,
                "ratio": one.ratio,
                "ratio_within_1mm": one.right_ratio,
                "paper_ratio": paper.numbers.density.ratio if one.speckle.scene == "belt_loaded" else None,
            }
            for one in paper.density
        ],
        "structured_light_on_a_moving_belt": [
            {"travel_mm": travel, "pictures_per_s_at_1_m_s": SPEED_MM_S / travel if travel else np.inf,
             **one.score.document()}
            for travel, one in zip(TRAVELS_MM, paper.moving, strict=False)
        ],
        "seconds": paper.seconds,
    }  # fmt: skip


class _Clock:
    """Measures the duration of each stage."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = perf_counter()

    def lap(self, stage: str) -> None:
        """Record the end of a stage."""
        now = perf_counter()
        self.laps[stage] = now - self._last
        self._last = now
