"""Samples of hole cells between rims, of a load whose true height is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.pose import Pose
from beltscape.evaluate.truth import find_true_belt
from beltscape.files.json_text import read_json
from beltscape.kernels import load as load_kernels
from beltscape.kernels.holes import HOLE_FEATURES
from beltscape.measure.surface import Grid
from beltscape.measure.volume.load import Load, compute_load
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.scene_assembly import SimulatedScene

CELLS = 5000
"""Number of cells drawn from a capture."""
BORDER_MM = 12.0
"""Strip at the belt's sides that is left out: there the true and the measured edge of the belt differ."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Features, targets (N,) and their scale (N,), mm."""

    names: tuple[str, ...]
    x: np.ndarray
    """(N, F) features."""
    y: np.ndarray
    scale_mm: np.ndarray


def draw_hole_samples(capture: Path, depth: DepthMap) -> Samples:
    """Return the samples of a capture from its reconstructed depth and its true load."""
    truth_file = next((capture / "truth").glob("*_load.npz"))
    volume = read_json(truth_file.with_name(truth_file.name.replace("_load.npz", "_scene.json")))["volume"]
    with np.load(truth_file) as truth:
        return sample_frame(capture, depth, dict(truth), volume["along_mm"])


def sample_frame(
    capture: Path, depth: DepthMap, truth: Mapping[str, np.ndarray], along_mm: tuple[float, float]
) -> Samples:
    """Return the samples of a frame's depth between two ends along the belt, both in the world as the true load."""
    scene = SimulatedScene(Scenario.model_validate(read_json(capture / "truth" / "scenario.json")))
    camera, core_from_world = scene.station.rig.core_camera, scene.station.core_from_world
    belt = find_true_belt(scene)
    belt_from_world = belt.belt_from_core @ core_from_world
    first, last = (float(end + belt_from_world.translation_mm[1]) for end in along_mm)
    cell = float(belt.belt_from_core.inverse().translation_mm[2] / camera.focal_px.mean())
    across = (belt.across_mm[0] + BORDER_MM, belt.across_mm[1] - BORDER_MM)
    grid = Grid.over(across, (first, last), cell)
    load = compute_load(depth, camera, belt, grid)
    return collect_samples(load, resample_truth(truth, belt_from_world, grid), cell)


def collect_samples(load: Load, truth_mm: np.ndarray, cell_mm: float) -> Samples:
    """Return samples of hole cells between rims."""
    pinhole = load.measured & ~np.isfinite(load.height_mm)
    return draw_cells(list_samples(load.height_mm, pinhole, load.ray_slope, truth_mm, cell_mm))


def list_samples(
    height_mm: np.ndarray, pinhole: np.ndarray, ray_slope: np.ndarray, truth_mm: np.ndarray, cell_mm: float
) -> Samples:
    """Return the samples of all hole cells between rims of a field (Ny, Nx) whose truth is not NaN."""
    hole = ~np.isfinite(height_mm)
    # the reference computes the features in double
    inputs = load_kernels("reference").hole_inputs(height_mm, pinhole, ray_slope, cell_mm)
    usable = np.flatnonzero(np.isfinite(inputs.base) & np.isfinite(truth_mm[hole]))
    scale = inputs.scale[usable]
    target = (truth_mm[hole] - inputs.base)[usable] / scale
    return Samples(HOLE_FEATURES, inputs.features[:, usable].T.astype(np.float32), target, scale)


def draw_cells(samples: Samples) -> Samples:
    """Return `CELLS` of the samples at most."""
    use = np.random.default_rng(1).permutation(len(samples.y))[:CELLS]
    return Samples(samples.names, samples.x[use], samples.y[use], samples.scale_mm[use])


def resample_truth(truth: Mapping[str, np.ndarray], belt_from_world: Pose, grid: Grid) -> np.ndarray:
    """Return the (Ny, Nx) true height of the load at a grid's cells."""
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    world = belt_from_world.inverse().apply(np.stack([x, y, np.zeros_like(x)], axis=-1))
    axes = [(world[..., 1], truth["y_mm"]), (world[..., 0], truth["x_mm"])]
    place = [(at - nodes[0]) / (nodes[1] - nodes[0]) for at, nodes in axes]
    return ndimage.map_coordinates(truth["height_mm"], place, order=1, mode="constant", cval=np.nan)
