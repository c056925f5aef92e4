"""Train the networks for holes and for edge fattening (measure/holes) on simulated captures with known truth.

    python tools/train_holes.py FOLDER LIST [held-out]

LIST is a text file with a line for each capture: GROUP CAPTURE FRAME EMPTY EMPTY_FRAME. CAPTURE and EMPTY (the same
kind of belt, empty) are what ``beltscape simulate`` wrote, the FRAMEs what ``beltscape reconstruct`` made of them.
A group should hold all captures of one heap or module. holes.json and edge_fattening.json are written to FOLDER.
With "held-out" each group is measured by networks trained on the other groups, and nothing is written; only these
figures describe the accuracy on new material.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.linalg import block_diag

from adam import Layers, Schedule, fit_layers
from beltscape.core.belt.empty_belt import Belt
from beltscape.core.geometry.pose import Pose
from beltscape.files.reconstruction import read_frame
from beltscape.measure.belt.empty_belt import learn_belt
from beltscape.measure.holes.edge_fattening import find_edge_fattening
from beltscape.measure.holes.fill import compute_hole_inputs, fill_holes
from beltscape.measure.network import LOG_VARIANCE, Network
from beltscape.measure.surface import Grid
from beltscape.measure.volume.box import Box
from beltscape.measure.volume.load import Load, compute_load
from beltscape.measure.volume.uncertainty import compute_volume_sigma

SCHEDULES = {
    "holes": Schedule((16, 8), epochs=6, batch=1024, decay=1e-5, last_scale=0.1),
    "edge_fattening": Schedule((12,), epochs=8, batch=512, decay=1e-4, last_scale=0.1),
}
CELLS = {"holes": 10_000, "edge_fattening": 4_000}
"""Number of cells drawn from a capture."""
MAX_TARGET = {"holes": 5.0, "edge_fattening": 1.2}
"""Absolute value to which targets are clipped."""
SPREAD_WEIGHT = 0.1
"""Weight of the likelihood of the spread, relative to the squared error of the mean."""
MEMBERS = 3
"""Size of the ensemble: networks from different initial weights, whose outputs are averaged."""
SMOOTH_SURFACES = 160
"""Number of simulated smooth surfaces and piles."""
BORDER_MM = 12.0
"""Strip at the belt's sides that is left out: there the true and the measured edge of the belt differ."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Features (N, F), targets (N,) and their scale (N,), mm."""

    x: np.ndarray
    y: np.ndarray
    scale_mm: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class TrainingCapture:
    """A capture with its load, truth and samples."""

    name: str
    group: str
    is_module: bool
    load: Load
    truth_mm: np.ndarray
    """(Ny, Nx) true load; NaN where it is not known."""
    belt: Belt
    along_mm: tuple[float, float]
    """The sides in y of the box in which its volume is compared."""
    samples: dict[str, Samples]


@cache
def learn_empty_belt(folder: Path) -> Belt:
    """Return the belt of an empty frame."""
    frame = read_frame(folder)
    return learn_belt([frame.depth], frame.rig.core_camera)


def read_core_from_world(capture: Path) -> Pose:
    """Return the core camera's true pose."""
    pose = json.loads((capture / "truth" / "station.json").read_text())["core_from_world"]
    return Pose(np.array(pose["rotation"]), np.array(pose["translation_mm"]))


def read_capture(group: str, capture: Path, frame: Path, empty: Path, empty_frame: Path) -> TrainingCapture:
    """Return a capture's load, truth and samples; the empty belt of another rig is transformed to this rig."""
    loaded = read_frame(frame)
    belt, pose = learn_empty_belt(empty_frame), read_core_from_world(capture)
    belt = replace(belt, belt_from_core=(belt.belt_from_core @ read_core_from_world(empty)) @ pose.inverse())
    belt_from_world = belt.belt_from_core @ pose
    truth_file = next((capture / "truth").glob("*_load.npz"))
    scene = json.loads(truth_file.with_name(truth_file.name.replace("_load.npz", "_scene.json")).read_text())
    along = tuple(float(end + belt_from_world.translation_mm[1]) for end in scene["volume"]["along_mm"])
    camera = loaded.rig.core_camera
    cell = float(belt.belt_from_core.inverse().translation_mm[2] / camera.focal_px.mean())
    grid = Grid.over(
        (belt.across_mm[0] + BORDER_MM, belt.across_mm[1] - BORDER_MM), (along[0], along[1]), cell
    )
    load = compute_load(loaded.depth, camera, belt, grid)
    truth = resample_truth(np.load(truth_file), belt_from_world, grid)
    return TrainingCapture(
        name=capture.name,
        group=group,
        is_module=truth_file.name == "module_load.npz",
        load=load,
        truth_mm=truth,
        belt=belt,
        along_mm=(along[0], along[1]),
        samples=collect_samples(load, truth, cell),
    )


def collect_samples(load: Load, truth_mm: np.ndarray, cell_mm: float) -> dict[str, Samples]:
    """Return samples of hole cells between rims, and of cells at edges, by network."""
    rng = np.random.default_rng(1)
    hole = ~np.isfinite(load.height_mm)
    inputs = compute_hole_inputs(
        load.height_mm, load.measured & hole, cell_mm, load.ray_slope, np.nonzero(hole)
    )
    use = draw_indices(inputs.profiles.is_between_rims & np.isfinite(truth_mm[hole]), "holes", rng)
    scale = inputs.surface.scale_mm[use]
    inside = Samples(inputs.features[use], (truth_mm[hole] - inputs.surface.base_mm)[use] / scale, scale)
    edge = find_edge_fattening(load.height_mm, load.ray_slope, cell_mm)
    excess = load.height_mm[edge.cells] - truth_mm[edge.cells]
    use = draw_indices(np.isfinite(excess), "edge_fattening", rng)
    drop = edge.drop_mm[use]
    return {"holes": inside, "edge_fattening": Samples(edge.features[use], excess[use] / drop, drop)}


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


def resample_truth(truth: np.lib.npyio.NpzFile, belt_from_world: Pose, grid: Grid) -> np.ndarray:
    """Return the (Ny, Nx) true height of the load at a grid's cells."""
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    world = belt_from_world.inverse().apply(np.stack([x, y, np.zeros_like(x)], axis=-1))
    axes = [(world[..., 1], truth["y_mm"]), (world[..., 0], truth["x_mm"])]
    place = [(at - nodes[0]) / (nodes[1] - nodes[0]) for at, nodes in axes]
    return ndimage.map_coordinates(truth["height_mm"], place, order=1, mode="constant", cval=np.nan)


@cache
def draw_smooth_samples(network: str) -> list[Samples]:
    """Return the samples of all smooth surfaces; they are the same in every run."""
    return [simulate_smooth_samples(np.random.default_rng(seed))[network] for seed in range(SMOOTH_SURFACES)]


def fit_network(captures: list[TrainingCapture], network: str) -> Network:
    """Fit the mean by least squares and the spread by the residual's Gaussian likelihood; captures weigh alike."""
    rng = np.random.default_rng(1)
    parts = []
    limit = MAX_TARGET[network]
    for samples in [one.samples[network] for one in captures] + draw_smooth_samples(network):
        if len(samples.y) > 0:
            weight = samples.scale_mm * (len(samples.y) / samples.scale_mm.sum())
            parts.append((samples.x, np.clip(samples.y, -limit, limit), weight))
    x, y, weight = (np.concatenate(part).astype(np.float32) for part in zip(*parts, strict=True))
    weight /= weight.mean()
    mean, scale = x.mean(axis=0), x.std(axis=0) + np.float32(1e-3)

    def gradient(outputs: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Return the derivative by mean and log variance; the spread does not influence the mean."""
        off = outputs[:, 0] - y[at]
        spread = SPREAD_WEIGHT * weight[at] * (1 - off * off * np.exp(-np.clip(outputs[:, 1], *LOG_VARIANCE)))
        slopes = np.stack([2 * weight[at] * off, np.clip(spread, -5, 5)], axis=1)
        return (slopes / len(at)).astype(np.float32)

    members = [fit_layers((x - mean) / scale, 2, gradient, SCHEDULES[network], rng) for _ in range(MEMBERS)]
    return Network(mean, scale, merge_networks(members))


def merge_networks(members: list[Layers]) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Return networks of the same inputs as one network whose outputs are their mean."""
    merged = []
    for depth, layers in enumerate(zip(*members, strict=True)):
        weights, offsets = [layer[0] for layer in layers], [layer[1] for layer in layers]
        if depth == len(members[0]) - 1:
            merged.append((np.concatenate(weights) / len(members), sum(offsets) / len(members)))
        elif depth == 0:
            merged.append((np.concatenate(weights, axis=1), np.concatenate(offsets)))
        else:
            merged.append((block_diag(*weights).astype(np.float32), np.concatenate(offsets)))
    return tuple(merged)


def fit_networks(captures: list[TrainingCapture]) -> tuple[Network, Network]:
    """Return the networks for holes and for edge fattening."""
    return fit_network(captures, "holes"), fit_network(captures, "edge_fattening")


def evaluate_volume(one: TrainingCapture, networks: tuple[Network, Network]) -> tuple[float, float]:
    """Return the error of the volume and its σ, %; print them with the shares of holes and edges."""
    load, cell = one.load, one.load.grid.cell_mm
    narrow = load.measured & ~np.isfinite(load.height_mm)
    filled = fill_holes(
        load.height_mm, load.sigma_mm, narrow, cell, load.ray_slope, windowed=load.windowed, networks=networks
    )
    volume = float(np.nansum(one.truth_mm)) * cell**2
    off = np.where(np.isfinite(one.truth_mm), filled.value_mm - one.truth_mm, 0.0)
    x = load.grid.x_mm
    weights = Box((float(x[0]) - cell / 2, float(x[-1]) + cell / 2), one.along_mm).integration_weights(
        load.grid
    )
    causes = compute_volume_sigma(load, filled, weights, one.belt)
    error, sigma = 100 * off.sum() * cell**2 / volume, 100 * causes.total_mm3 / volume
    holes = 100 * off[filled.hole].sum() * cell**2 / volume
    print(
        f"{one.group:6s}{one.name:6s} error {error:+6.2f} % σ {sigma:5.2f} %, in holes {holes:+6.2f} % "
        f"(σ {100 * causes.holes_mm3 / volume:5.2f} %, edges {100 * causes.edges_mm3 / volume:5.2f} %)  "
        f"rms in holes {np.sqrt((off[filled.hole] ** 2).mean()):5.1f} mm",
        flush=True,
    )
    return error, sigma


def summarise(kind: str, figures: list[tuple[float, float]]) -> str:
    """Return the statistics of (error, σ), %, over captures."""
    error, sigma = np.array(figures).T
    return (
        f"{kind}: {len(error)}, mean {error.mean():+.2f} %, mean size {np.abs(error).mean():.2f} %, "
        f"rms {np.sqrt((error**2).mean()):.2f} %, rms of error/σ {np.sqrt(((error / sigma) ** 2).mean()):.2f}"
    )


def evaluate_held_out(captures: list[TrainingCapture]) -> None:
    """Print the figures of each group by networks trained on the other groups, and their statistics."""
    figures: dict[str, list[tuple[float, float]]] = {}
    for group in dict.fromkeys(one.group for one in captures):
        networks = fit_networks([one for one in captures if one.group != group])
        for one in captures:
            if one.group == group:
                kind = "modules" if one.is_module else "heaps"
                figures.setdefault(kind, []).append(evaluate_volume(one, networks))
    for kind, part in figures.items():
        print(summarise(kind, part))


def main(out: str, listed: str, mode: str = "") -> None:
    """Train the networks and write them, or evaluate them on groups held out."""
    rows = [line.split() for line in Path(listed).read_text().splitlines() if line.strip()]
    captures = [read_capture(row[0], *(Path(part) for part in row[1:])) for row in rows]
    if mode == "held-out":
        evaluate_held_out(captures)
        return
    for name, network in zip(("holes", "edge_fattening"), fit_networks(captures), strict=True):
        text = json.dumps(network.to_document(), separators=(",", ":")) + "\n"
        (Path(out) / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
