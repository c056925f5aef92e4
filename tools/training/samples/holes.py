"""Samples of hole cells between rims, and of cells at edges, of captures and of simulated smooth surfaces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.pose import Pose
from beltscape.evaluate.truth.true_belt import find_true_belt
from beltscape.files.documents.json_text import read_json
from beltscape.measure.holes.edge_fattening import find_edge_fattening
from beltscape.measure.holes.fill import compute_hole_inputs
from beltscape.measure.surface import Grid
from beltscape.measure.volume.load import Load, compute_load
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.scene_assembly import SimulatedScene

CELLS = {"holes": 10_000, "edge_fattening": 4_000}
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


def draw_hole_samples(capture: Path, depth: DepthMap) -> dict[str, Samples]:
    """Return the samples of a capture, by network, from its reconstructed depth and its true load."""
    scene = SimulatedScene(Scenario.model_validate(read_json(capture / "truth" / "scenario.json")))
    camera, core_from_world = scene.station.rig.core_camera, scene.station.core_from_world
    belt = find_true_belt(scene)
    belt_from_world = belt.belt_from_core @ core_from_world
    truth_file = next((capture / "truth").glob("*_load.npz"))
    volume = read_json(truth_file.with_name(truth_file.name.replace("_load.npz", "_scene.json")))["volume"]
    first, last = (float(end + belt_from_world.translation_mm[1]) for end in volume["along_mm"])
    cell = float(belt.belt_from_core.inverse().translation_mm[2] / camera.focal_px.mean())
    across = (belt.across_mm[0] + BORDER_MM, belt.across_mm[1] - BORDER_MM)
    grid = Grid.over(across, (first, last), cell)
    load = compute_load(depth, camera, belt, grid)
    with np.load(truth_file) as truth:
        true_mm = resample_truth(dict(truth), belt_from_world, grid)
    return collect_samples(load, true_mm, cell)


def collect_samples(load: Load, truth_mm: np.ndarray, cell_mm: float) -> dict[str, Samples]:
    """Return samples of hole cells between rims, and of cells at edges, by network."""
    rng = np.random.default_rng(1)
    hole = ~np.isfinite(load.height_mm)
    inputs = compute_hole_inputs(
        load.height_mm, load.measured & hole, cell_mm, load.ray_slope, np.nonzero(hole)
    )
    use = draw_indices(inputs.profiles.is_between_rims & np.isfinite(truth_mm[hole]), "holes", rng)
    scale = inputs.surface.scale_mm[use]
    target = (truth_mm[hole] - inputs.surface.base_mm)[use] / scale
    inside = Samples(*_make_table(inputs.features, use), target, scale)
    edge = find_edge_fattening(load.height_mm, load.ray_slope, cell_mm)
    excess = load.height_mm[edge.cells] - truth_mm[edge.cells]
    use = draw_indices(np.isfinite(excess), "edge_fattening", rng)
    drop = edge.drop_mm[use]
    edges = Samples(*_make_table(edge.features, use), excess[use] / drop, drop)
    return {"holes": inside, "edge_fattening": edges}


def _make_table(features: Mapping[str, np.ndarray], use: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the names of features (M,), and those of the chosen samples as a table (N, F)."""
    return tuple(features), np.stack([values[use] for values in features.values()], axis=1).astype(np.float32)


def simulate_smooth_samples(rng: np.random.Generator) -> dict[str, Samples]:
    """Return samples of a random smooth surface or pile (without unit) with noise, which continues in its holes."""
    shape = (160, 160)
    x, y = np.meshgrid(*(np.arange(count) - count / 2 for count in reversed(shape)))
    steep = rng.uniform(0, 0.8) * np.exp(2j * np.pi * rng.random())
    truth = steep.real * x + steep.imag * y
    waves = ndimage.gaussian_filter(rng.standard_normal(shape), rng.uniform(10, 40), mode="wrap")
    truth = truth + rng.uniform(0, 0.5) * waves / np.std(np.diff(waves, axis=0))
    truth += -truth.min() + rng.choice([0.0, 10.0, 100.0])
    if rng.random() < 0.6:
        truth = np.maximum(0.1 * truth, simulate_piles(x, y, rng))
    seeds = rng.random(shape) < 10 ** rng.uniform(-3.3, -2)
    hole = ndimage.distance_transform_edt(~seeds) < rng.uniform(1, 14, shape)
    if rng.random() < 0.3:  # single missing pixels
        hole |= rng.random(shape) < rng.uniform(0.02, 0.3)
    noise = 10 ** rng.uniform(-2.5, -0.5) * rng.standard_normal(shape)
    ray_slope = np.full((2, *shape), rng.uniform(-0.4, 0.4, 2)[:, None, None])
    measured = np.where(hole, np.nan, truth + noise)
    load = Load(Grid((0.0, 0.0), 1.0, shape), measured, measured, measured, ~hole, ray_slope, windowed=False)
    return collect_samples(load, truth, 1.0)


def simulate_piles(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the (Ny, Nx) heights of random cones, domes and balls on a level plane."""
    height = np.zeros(x.shape)
    for across, along, reach in rng.uniform([-70, -70, 20], [70, 70, 60], (rng.integers(1, 4), 3)):
        radius = np.hypot(x - across, y - along) / reach
        high = reach * rng.uniform(0.3, 1.0)
        shape = [1 - radius, 1 - radius**2, np.sqrt(np.clip(1 - radius**2, 0, None))][rng.integers(3)]
        height = np.maximum(height, high * shape)
    return height


def draw_indices(mask: np.ndarray, network: str, rng: np.random.Generator) -> np.ndarray:
    """Draw the indices of some cells of a mask."""
    return rng.permutation(np.flatnonzero(mask))[: CELLS[network]]


def resample_truth(truth: Mapping[str, np.ndarray], belt_from_world: Pose, grid: Grid) -> np.ndarray:
    """Return the (Ny, Nx) true height of the load at a grid's cells."""
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    world = belt_from_world.inverse().apply(np.stack([x, y, np.zeros_like(x)], axis=-1))
    axes = [(world[..., 1], truth["y_mm"]), (world[..., 0], truth["x_mm"])]
    place = [(at - nodes[0]) / (nodes[1] - nodes[0]) for at, nodes in axes]
    return ndimage.map_coordinates(truth["height_mm"], place, order=1, mode="constant", cval=np.nan)
