"""Benchmark of single kernels on a rendered frame: time and throughput by instruction set, beside OpenCV."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from beltscape.kernels import Kernels, load
from beltscape.kernels.native import levels
from beltscape.learned.registry import load_network
from beltscape.stereo.multiview.estimate import (
    assign_addresses,
    gather_neighbour_addresses,
    load_message_rounds,
)
from beltscape.stereo.multiview.frame import MatchContext, PreparedFrame
from beltscape.stereo.multiview.optimisation import list_propagation_offsets
from beltscape.stereo.multiview.photoconsistency import compute_difference_variance
from beltscape.stereo.multiview.preparation import prepare_frame
from beltscape.stereo.multiview.surface import OCCLUDER_PX
from beltscape.stereo.settings import MultiviewSettings
from captures import Scene
from matching.triangulation import random_points
from tables import format_head
from timing import measure_seconds

PLANES = 64
_JUMPS = 7, 40
_ALONE = {"aggregate", "rasterise_heights"}
_CROP_PX = 48
"""Edge of the image's centre that the reference kernels process."""
NOTES = f"""\
Cells: ms (throughput): Mpx/s of the core; of sweep, aggregate and both at once Mde/s: pixels × {PLANES} planes.
Frame: the rendered module, four auxiliaries, true depth. Beside: cv2.remap, cubic, of a ready map (warp);
{PLANES} × 4 of cv2.remap, bilinear, alone, without any comparison (sweep); cv2.StereoSGBM HH with as many
disparities, its own matching cost included (aggregate); cv2.triangulatePoints of 2 views (triangulate has 5);
scipy.ndimage.spline_filter (spline_coefficients); all with one thread. aggregate and rasterise_heights run on one
thread only. The holes that are filled are 5 % of the pixels. Candidate surfaces and the photo-consistency of all 9
are for a fifth of the pixels, as are gather (24 neighbours and the pixel itself, of 2 planes) and pass_messages (a
round); evaluate_network: 52 planes, 64 units, 2 outputs.
Reference: NumPy in float64 on {_CROP_PX}² px."""


@dataclass(frozen=True)
class Case:
    """Input of the kernels."""

    prepared: PreparedFrame
    s: np.ndarray
    slopes: tuple[np.ndarray, np.ndarray]
    planes: int = PLANES

    @property
    def first(self) -> float:
        """Inverse depth of the first plane; the planes cover the range of the surface."""
        return float(np.nanmin(self.s))

    @property
    def step(self) -> float:
        """Distance of the planes in inverse depth."""
        return float(np.nanmax(self.s) - self.first) / (self.planes - 1)

    def crop(self) -> Case:
        """Return the case for the centre of the core's image, with shifted projections."""
        top, left = ((n - _CROP_PX) // 2 for n in self.s.shape)
        part = np.s_[top : top + _CROP_PX, left : left + _CROP_PX]
        views = self.prepared.views.astype(np.float64)
        views[:, [2, 5, 8]] += views[:, [0, 3, 6]] * left + views[:, [1, 4, 7]] * top
        prepared = replace(
            self.prepared,
            core=np.ascontiguousarray(self.prepared.core[part]),
            views=views.astype(np.float32),
        )
        slope_u, slope_v = (np.ascontiguousarray(x[part]) for x in self.slopes)
        return Case(prepared, np.ascontiguousarray(self.s[part]), (slope_u, slope_v), 8)


Call = Callable[[Kernels, int], object]


def kernels(scenes: list[Scene]) -> list[str]:
    """Return a row per kernel and size."""
    best = levels()[-1]
    others = list(reversed(levels()[:-1]))
    columns = ["kernel", "size", f"{best}, 1 thread", f"{best}, 2", *others, "OpenCV / SciPy", "reference"]
    cv2.setNumThreads(1)
    tables = [_rows(scene, best, others) for scene in scenes]
    return [*format_head(columns), *(row for same in zip(*tables, strict=True) for row in same)]


def _rows(scene: Scene, best: str, others: list[str]) -> list[str]:
    case = _case(scene)
    small = case.crop()
    calls, small_calls, baselines = _calls(case), _calls(small), _baselines(case)
    rows = []
    for name, call in calls.items():
        planes, few = (
            (c.planes if name in {"sweep", "aggregate", "sweep_and_aggregate"} else 1) for c in (case, small)
        )
        amount = case.s.size * planes
        times = [
            _measure_call(call, load(best), 1),
            _measure_call(call, load(best), 2) if name not in _ALONE else None,
        ]
        times += [_measure_call(call, load(level), 1) for level in others]
        times.append(measure_seconds(baselines[name], 3) if name in baselines else None)
        cells = [
            "" if t is None else f"{t * 1e3:.2f} ({_format_throughput(amount / t / 1e6)})" for t in times
        ]
        rows.append(
            f"| {name} | {scene.size} | {' | '.join(cells)} | {_measure_reference(small_calls[name], small, few)} |"
        )
    return rows


def _format_throughput(value: float) -> str:
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def _measure_call(call: Call, with_kernels: Kernels, threads: int) -> float:
    return measure_seconds(lambda: call(with_kernels, threads), 5, 0.3)


def _measure_reference(call: Call, case: Case, planes: int) -> str:
    reference = load("reference")
    start = time.perf_counter()
    call(reference, 1)
    return f"{case.s.size * planes / (time.perf_counter() - start) / 1e6:.3g}"


def _case(scene: Scene) -> Case:
    names = scene.rig.auxiliaries
    context = MatchContext.for_grid(scene.rig, names, 1, load(), 0)
    prepared = prepare_frame(scene.frame, context)
    s = (1 / (scene.true_depth_mm * context.inverse_depth_scale)).astype(np.float32)
    s = np.where(np.isfinite(s), s, np.float32(np.nanmedian(s)))
    slope_v, slope_u = (ndimage.median_filter(x, 3).clip(-1, 1) for x in np.gradient(s))
    return Case(prepared, s, (slope_u, slope_v))


def _calls(case: Case) -> dict[str, Call]:
    """Return a call of every kernel."""
    return _matching_calls(case) | _selection_calls(case) | _field_calls(case)


def _matching_calls(case: Case) -> dict[str, Call]:
    """Return calls of the sweep, propagation and least squares with the matcher's settings."""
    p, s, (slope_u, slope_v) = case.prepared, case.s, case.slopes
    floor, native = p.noise.floor, load()
    sizes = [image.shape[::-1] for image in p.images]
    buffers = native.inverse_depth_buffers(s, p.views, sizes)
    planes = case.first, case.step, case.planes, floor
    cost = native.sweep(p.core, p.images, p.views, *planes)
    offsets = list_propagation_offsets(tuple(int(d) for d in MultiviewSettings().distances_px))
    noise: dict[str, Any] = {
        "floor": floor,
        "noise_variance": p.noise.levels,
        "model_variance": p.noise.model,
    }
    equations = native.normal_equations(s, p.core, p.coefficients, p.views, **noise)
    return {
        "spline_coefficients": lambda k, n: k.spline_coefficients(p.core, threads=n),
        "warp": lambda k, n: k.warp(s, p.views[0], p.coefficients[0], threads=n),
        "sweep": lambda k, n: k.sweep(p.core, p.images, p.views, *planes, threads=n),
        "aggregate": lambda k, _: k.aggregate(cost, *_JUMPS),
        "sweep_and_aggregate": lambda k, n: k.sweep_and_aggregate(
            p.core, p.images, p.views, *planes, *_JUMPS, threads=n
        ),
        "propagate": lambda k, n: k.propagate(
            s, slope_u, slope_v, p.core, p.images, p.views, buffers,
            offsets=offsets, floor=floor, tolerance=OCCLUDER_PX, threads=n,
        ),
        "inverse_depth_buffers": lambda k, n: k.inverse_depth_buffers(s, p.views, sizes, threads=n),
        "normal_equations": lambda k, n: k.normal_equations(
            s, p.core, p.coefficients, p.views, **noise, threads=n
        ),
        "local_fit": lambda k, n: k.local_fit(
            equations.information, equations.pull, s, slope_u, slope_v, tolerance=0.25, threads=n
        ),
    }  # fmt: skip


def _selection_calls(case: Case) -> dict[str, Call]:
    """Return calls of the kernels about the candidates of uncertain pixels."""
    p, s, (slope_u, slope_v), native = case.prepared, case.s, case.slopes, load()
    buffers = native.inverse_depth_buffers(s, p.views, [image.shape[::-1] for image in p.images])
    uncertain, reliable = _uncertain(s)
    candidates = native.candidate_surfaces(s, slope_u, slope_v, reliable, *uncertain, reach=8, separation=1.0)
    photometry: dict[str, Any] = {
        "core": p.core,
        "variance": compute_difference_variance(p.filled_core, p.noise),
        "images": p.images,
    }
    photometry |= {"views": p.views, "buffers": buffers, "gains": [np.ones_like(s) for _ in p.images]}
    network, around_one = load_network("confidence"), np.moveaxis(np.mgrid[-2:3, -2:3], 0, -1).reshape(-1, 2)
    features = [s] * len(network.features)
    first_round, (messages, neighbours, states) = load_message_rounds()[0], _messages(~reliable)
    return {
        "candidate_surfaces": lambda k, n: k.candidate_surfaces(
            s, slope_u, slope_v, reliable, *uncertain, reach=8, separation=1.0, threads=n
        ),
        "photo_consistency": lambda k, n: k.photo_consistency(
            *uncertain, *candidates[:3], **photometry, tolerance=OCCLUDER_PX, threads=n
        ),
        "gather": lambda k, n: k.gather([s, p.core], *uncertain, around_one, threads=n),
        "pass_messages": lambda k, n: k.pass_messages(
            messages, neighbours, states, first_round.layers, threads=n
        ),
        "evaluate_network": lambda k, n: k.evaluate_network(features, network.limits, network.layers, threads=n),
    }  # fmt: skip


def _field_calls(case: Case) -> dict[str, Call]:
    """Return calls of the kernels on depth maps, height maps and points."""
    depth, (projections, pixels) = np.median(case.s) / case.s, random_points(case.s.size)
    holed, holes = _add_holes(depth), load_network("holes")
    sigma, network = np.full_like(holed, 1e-3), (holes.features, holes.limits, holes.layers)
    return {
        "triangulate": lambda k, n: k.triangulate(projections, pixels, threads=n),
        "rasterise_heights": lambda k, n: k.rasterise_heights(
            depth, np.ones_like(depth), np.isfinite(depth), np.eye(3, 4), 0.05, depth.shape, threads=n
        ),
        "fill_holes": lambda k, n: k.fill_holes(
            (holed, sigma), np.zeros(holed.shape, bool), np.zeros((2, *holed.shape)), 0.01, network, threads=n
        ),
    }  # fmt: skip


def _uncertain(s: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Return columns and rows of a fifth of the pixels, in patches, and the mask (H, W) of the others."""
    noise = ndimage.gaussian_filter(np.random.default_rng(3).normal(size=s.shape), 2)
    uncertain = noise > np.quantile(noise, 0.8)
    rows, columns = np.nonzero(uncertain)
    return (columns, rows), ~uncertain


def _messages(uncertain: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return messages, the neighbours' addresses and the rest of the states of random uncertain pixels."""
    outputs, pixels = load_network("refinement").outputs, np.count_nonzero(uncertain)
    states = np.random.default_rng(4).normal(size=(len(outputs), pixels)).astype(np.float32)
    length = sum(name.startswith("message") for name in outputs)
    messages = np.zeros((length + 2, 2 + pixels), np.float32)
    messages[:length, 2:], messages[length:, :2], rest = states[:length], np.eye(2), states[length:]
    neighbours = gather_neighbour_addresses(assign_addresses(uncertain, ~uncertain), uncertain, 1)
    return messages, neighbours, rest


def _add_holes(depth: np.ndarray) -> np.ndarray:
    """Return zero-mean depths with holes."""
    noise = ndimage.gaussian_filter(np.random.default_rng(2).normal(size=depth.shape), 3)
    return np.where(noise > np.quantile(noise, 0.95), np.nan, depth - depth.mean())


def _baselines(case: Case) -> dict[str, Callable[[], object]]:
    """Return the most similar OpenCV or SciPy functions, called on the same data."""
    p, (height, width) = case.prepared, case.s.shape
    u, v = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    u, v = u + np.float32(0.3), v + np.float32(0.6)
    image = p.images[0]
    bytes_ = [np.nan_to_num(x).clip(0, 255).astype(np.uint8) for x in (p.core, image)]
    matcher = cv2.StereoSGBM_create(0, case.planes, 3, 72, 360, mode=cv2.StereoSGBM_MODE_HH)
    projections, pixels = random_points(case.s.size)
    first, second = pixels[0].T.copy(), pixels[1].T.copy()

    def remaps() -> None:
        for _ in range(case.planes * len(p.images)):
            cv2.remap(image, u, v, cv2.INTER_LINEAR)

    return {
        "spline_coefficients": lambda: ndimage.spline_filter(
            np.nan_to_num(p.core), 3, output=np.float32, mode="mirror"
        ),
        "warp": lambda: cv2.remap(image, u, v, cv2.INTER_CUBIC),
        "sweep": remaps,
        "aggregate": lambda: matcher.compute(*bytes_),
        "triangulate": lambda: cv2.triangulatePoints(projections[0], projections[1], first, second),
    }
