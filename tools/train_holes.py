"""Fit the networks for holes and for edge fattening (measure/holes) to simulated captures with known truth.

    python tools/train_holes.py FOLDER LIST [held-out]

LIST is a text file with a line for each capture: GROUP CAPTURE FRAME EMPTY EMPTY_FRAME. CAPTURE and EMPTY (the same
kind of belt, empty) are what ``beltscape simulate`` wrote, the FRAMEs what ``beltscape reconstruct`` made of them.
Groups should hold all captures of one heap or module. holes.json and edge_fattening.json are written into FOLDER.
With "held-out" each group is measured by networks fitted to the other groups, and nothing is written: these figures
count.
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

from adam import Layers, Schedule, fitted
from beltscape.core.belt.empty_belt import Belt
from beltscape.core.pose import Pose
from beltscape.files.reconstruction import read_frame
from beltscape.measure.belt.empty_belt import learn_belt
from beltscape.measure.holes.edge_fattening import find_edge_fattening
from beltscape.measure.holes.fill import compute_hole_inputs, fill_holes
from beltscape.measure.network import LOG_VARIANCE, Network
from beltscape.measure.surface import Grid
from beltscape.measure.volume.box import Box
from beltscape.measure.volume.load import Load, compute_load
from beltscape.measure.volume.uncertainty import compute_volume_sigma

INSIDE = Schedule((16, 8), epochs=6, batch=1024, decay=1e-5, first=0.1)
BESIDE = Schedule((12,), epochs=8, batch=512, decay=1e-4, first=0.1)
CELLS = {"holes": 10_000, "edge_fattening": 4_000}
"""Cells of a capture to learn from."""
MOST = {"holes": 5.0, "edge_fattening": 1.2}
"""Targets count up to here."""
SPREAD = 0.1
"""Weight of the spread's likelihood beside the mean's square."""
VOTES = 3
"""Networks from different starts, whose mean counts: what one of them makes up does not."""
SMOOTH = 160
"""Smooth surfaces and piles to learn from."""
BORDER_MM = 12.0
"""Strip at the belt's ends that is left out: there the truth's edge is another than the measured one."""


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """Features (N, F), targets (N,) and their scale (N,), mm."""

    x: np.ndarray
    y: np.ndarray
    scale_mm: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One capture."""

    name: str
    group: str
    load: Load
    truth_mm: np.ndarray
    """(Ny, Nx) true load; NaN where it is not known."""
    belt: Belt
    along_mm: tuple[float, float]
    """The box in which its volume is told."""
    lessons: dict[str, Lesson]


@cache
def empty_belt(frame: Path) -> Belt:
    """The belt of an empty frame."""
    found = read_frame(frame)
    return learn_belt([found.depth], found.rig.core_camera)


def core_from_world(capture: Path) -> Pose:
    """As the simulator placed the core."""
    pose = json.loads((capture / "truth" / "station.json").read_text())["core_from_world"]
    return Pose(np.array(pose["rotation"]), np.array(pose["translation_mm"]))


def sample(group: str, capture: Path, frame: Path, empty: Path, empty_frame: Path) -> Sample:
    """Load, truth and lessons of a capture, over the belt of another rig's empty one put where this rig sees it."""
    found = read_frame(frame)
    belt, pose = empty_belt(empty_frame), core_from_world(capture)
    belt = replace(belt, belt_from_core=(belt.belt_from_core @ core_from_world(empty)) @ pose.inverse())
    belt_from_world = belt.belt_from_core @ pose
    truth_file = next((capture / "truth").glob("*_load.npz"))
    scene = json.loads(truth_file.with_name(truth_file.name.replace("_load.npz", "_scene.json")).read_text())
    along = tuple(float(end + belt_from_world.translation_mm[1]) for end in scene["volume"]["along_mm"])
    camera = found.rig.core_camera
    cell = float(belt.belt_from_core.inverse().translation_mm[2] / camera.focal_px.mean())
    grid = Grid.over(
        (belt.across_mm[0] + BORDER_MM, belt.across_mm[1] - BORDER_MM), (along[0], along[1]), cell
    )
    load = compute_load(found.depth, camera, belt, grid)
    truth = true_load(np.load(truth_file), belt_from_world, grid)
    return Sample(capture.name, group, load, truth, belt, (along[0], along[1]), lessons(load, truth, cell))


def lessons(load: Load, truth_mm: np.ndarray, cell_mm: float) -> dict[str, Lesson]:
    """What some hole cells between rims see and where they truly are, and the same of brinks."""
    rng = np.random.default_rng(1)
    hole = ~np.isfinite(load.height_mm)
    view = compute_hole_inputs(
        load.height_mm, load.measured & hole, cell_mm, load.ray_slope, np.nonzero(hole)
    )
    use = chosen(view.profiles.is_between_rims & np.isfinite(truth_mm[hole]), "holes", rng)
    scale = view.surface.scale_mm[use]
    inside = Lesson(view.features[use], (truth_mm[hole] - view.surface.base_mm)[use] / scale, scale)
    edge = find_edge_fattening(load.height_mm, load.ray_slope, cell_mm)
    high = load.height_mm[edge.cells] - truth_mm[edge.cells]
    use = chosen(np.isfinite(high), "edge_fattening", rng)
    drop = edge.drop_mm[use]
    return {"holes": inside, "edge_fattening": Lesson(edge.features[use], high[use] / drop, drop)}


def smooth_lessons(rng: np.random.Generator) -> dict[str, Lesson]:
    """The same of a smooth surface or pile without units, with more or less noise: it goes on in its holes."""
    shape = (160, 160)
    x, y = np.meshgrid(*(np.arange(count) - count / 2 for count in reversed(shape)))
    steep = rng.uniform(0, 0.8) * np.exp(2j * np.pi * rng.random())
    truth = steep.real * x + steep.imag * y
    waves = ndimage.gaussian_filter(rng.standard_normal(shape), rng.uniform(10, 40), mode="wrap")
    truth = truth + rng.uniform(0, 0.5) * waves / np.std(np.diff(waves, axis=0))
    truth += -truth.min() + rng.choice([0.0, 10.0, 100.0])
    if rng.random() < 0.6:
        truth = np.maximum(0.1 * truth, piles(x, y, rng))
    seeds = rng.random(shape) < 10 ** rng.uniform(-3.3, -2)
    hole = ndimage.distance_transform_edt(~seeds) < rng.uniform(1, 14, shape)
    if rng.random() < 0.3:  # pixels that fail one by one
        hole |= rng.random(shape) < rng.uniform(0.02, 0.3)
    noise = 10 ** rng.uniform(-2.5, -0.5) * rng.standard_normal(shape)
    ray_slope = np.full((2, *shape), rng.uniform(-0.4, 0.4, 2)[:, None, None])
    measured = np.where(hole, np.nan, truth + noise)
    load = Load(Grid((0.0, 0.0), 1.0, shape), measured, measured, measured, ~hole, ray_slope, windowed=False)
    return lessons(load, truth, 1.0)


def piles(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(Ny, Nx) cones, domes and balls on the level, as smooth as the surfaces of things are."""
    found = np.zeros(x.shape)
    for across, along, reach in rng.uniform([-70, -70, 20], [70, 70, 60], (rng.integers(1, 4), 3)):
        out = np.hypot(x - across, y - along) / reach
        high = reach * rng.uniform(0.3, 1.0)
        shape = [1 - out, 1 - out**2, np.sqrt(np.clip(1 - out**2, 0, None))][rng.integers(3)]
        found = np.maximum(found, high * shape)
    return found


def chosen(good: np.ndarray, what: str, rng: np.random.Generator) -> np.ndarray:
    """Indices of some good cells."""
    return rng.permutation(np.flatnonzero(good))[: CELLS[what]]


def true_load(truth: np.lib.npyio.NpzFile, belt_from_world: Pose, grid: Grid) -> np.ndarray:
    """(Ny, Nx) true height of the load at a grid's cells."""
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    world = belt_from_world.inverse().apply(np.stack([x, y, np.zeros_like(x)], axis=-1))
    axes = [(world[..., 1], truth["y_mm"]), (world[..., 0], truth["x_mm"])]
    place = [(at - nodes[0]) / (nodes[1] - nodes[0]) for at, nodes in axes]
    return ndimage.map_coordinates(truth["height_mm"], place, order=1, mode="constant", cval=np.nan)


@cache
def smooth(what: str) -> list[Lesson]:
    """Lessons of smooth surfaces, always the same."""
    return [smooth_lessons(np.random.default_rng(seed))[what] for seed in range(SMOOTH)]


def fit(samples: list[Sample], what: str, how: Schedule) -> Network:
    """Least squares of the mean, the residual's Gaussian likelihood of the spread; every capture counts alike."""
    rng = np.random.default_rng(1)
    parts = []
    lessons_of = [one.lessons[what] for one in samples] + smooth(what)
    for lesson in filter(lambda lesson: len(lesson.y) > 0, lessons_of):
        weight = lesson.scale_mm * (len(lesson.y) / lesson.scale_mm.sum())
        parts.append((lesson.x, np.clip(lesson.y, -MOST[what], MOST[what]), weight))
    x, y, weight = (np.concatenate(part).astype(np.float32) for part in zip(*parts, strict=True))
    weight /= weight.mean()
    mean, scale = x.mean(axis=0), x.std(axis=0) + np.float32(1e-3)

    def slopes(told: np.ndarray, at: np.ndarray) -> np.ndarray:
        """By mean and log variance; the spread does not move the mean."""
        off = told[:, 0] - y[at]
        spread = SPREAD * weight[at] * (1 - off * off * np.exp(-np.clip(told[:, 1], *LOG_VARIANCE)))
        both = np.stack([2 * weight[at] * off, np.clip(spread, -5, 5)], axis=1)
        return (both / len(at)).astype(np.float32)

    one_by_one = [fitted((x - mean) / scale, 2, slopes, how, rng) for _ in range(VOTES)]
    return Network(mean, scale, side_by_side(one_by_one))


def side_by_side(members: list[Layers]) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Networks of the same inputs as one whose outputs are their mean."""
    found = []
    for depth, layers in enumerate(zip(*members, strict=True)):
        weights, offsets = [layer[0] for layer in layers], [layer[1] for layer in layers]
        if depth == len(members[0]) - 1:
            found.append((np.concatenate(weights) / len(members), sum(offsets) / len(members)))
        elif depth == 0:
            found.append((np.concatenate(weights, axis=1), np.concatenate(offsets)))
        else:
            found.append((block_diag(*weights).astype(np.float32), np.concatenate(offsets)))
    return tuple(found)


def networks(samples: list[Sample]) -> tuple[Network, Network]:
    """For holes and for brinks."""
    return fit(samples, "holes", INSIDE), fit(samples, "edge_fattening", BESIDE)


def report(one: Sample, by: tuple[Network, Network]) -> tuple[float, float]:
    """Error of the volume and its σ, %, printed with what measured cells and holes each do."""
    load, cell = one.load, one.load.grid.cell_mm
    narrow = load.measured & ~np.isfinite(load.height_mm)
    filled = fill_holes(
        load.height_mm, load.sigma_mm, narrow, cell, load.ray_slope, windowed=load.windowed, networks=by
    )
    known = np.isfinite(one.truth_mm)
    volume = float(np.nansum(one.truth_mm)) * cell**2
    off = np.where(known, filled.value_mm - one.truth_mm, 0.0)
    x = load.grid.x_mm
    weights = Box((float(x[0]) - cell / 2, float(x[-1]) + cell / 2), one.along_mm).integration_weights(
        load.grid
    )
    causes = compute_volume_sigma(load, filled, weights, one.belt)
    error, sigma = 100 * off.sum() * cell**2 / volume, 100 * causes.total_mm3 / volume
    holes = 100 * off[filled.hole].sum() * cell**2 / volume
    print(
        f"{one.group:6s}{one.name:6s} error {error:+6.2f} % σ {sigma:5.2f} %  of it in holes {holes:+6.2f} % "
        f"(σ {100 * causes.holes_mm3 / volume:5.2f} %, edges {100 * causes.edges_mm3 / volume:5.2f} %)  "
        f"rms in holes {np.sqrt((off[filled.hole] ** 2).mean()):5.1f} mm",
        flush=True,
    )
    return error, sigma


def summary(kind: str, found: list[tuple[float, float]]) -> str:
    """Over captures."""
    error, sigma = np.array(found).T
    return (
        f"{kind}: {len(error)}, mean {error.mean():+.2f} %, mean size {np.abs(error).mean():.2f} %, "
        f"rms {np.sqrt((error**2).mean()):.2f} %, rms of error/σ {np.sqrt(((error / sigma) ** 2).mean()):.2f}"
    )


def main(out: str, captures: str, what: str = "") -> None:
    """Fit and write, or hold out."""
    rows = [line.split() for line in Path(captures).read_text().splitlines() if line.strip()]
    samples = [sample(row[0], *(Path(part) for part in row[1:])) for row in rows]
    if what != "held-out":
        for name, network in zip(("holes", "edge_fattening"), networks(samples), strict=True):
            text = json.dumps(network.to_document(), separators=(",", ":")) + "\n"
            (Path(out) / f"{name}.json").write_text(text, encoding="utf-8")
        return
    found: dict[str, list[tuple[float, float]]] = {}
    for group in dict.fromkeys(one.group for one in samples):
        by = networks([one for one in samples if one.group != group])
        for one in samples:
            if one.group == group:
                kind = (
                    "modules"
                    if any(Path(row[1]).name == one.name and _module(row) for row in rows)
                    else "heaps"
                )
                found.setdefault(kind, []).append(report(one, by))
    for kind, figures in found.items():
        print(summary(kind, figures))


def _module(row: list[str]) -> bool:
    """Whether a line's capture is one of a module."""
    return any((Path(row[1]) / "truth").glob("module_load.npz"))


if __name__ == "__main__":
    main(*sys.argv[1:])
