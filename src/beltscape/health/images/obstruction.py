"""Dirt on a window: less light at fixed pixels of one camera than the other cameras receive from the same points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.alarm_catalogue import DIRT
from beltscape.core.arrays import Float32Array
from beltscape.core.depth import DepthMap
from beltscape.core.findings import Finding
from beltscape.core.geometry.rig import Rig
from beltscape.core.statistics import compute_median, drop_nan
from beltscape.core.translatable_message import make_message
from beltscape.health.image_statistics import GRID, compute_block_size, find_place, remove_single_blocks
from beltscape.health.settings import HealthSettings

MEMORY, SHORT_MEMORY = 60.0, 3.0
"""Numbers of samples over which the light is averaged for faint and for nearly opaque dirt."""
_LEAST_SAMPLES = 10.0
"""Number of samples of a block from which its light is judged: occlusions by material then average out."""
_LEAST_SHORT = 1.8
"""Least number of samples for nearly opaque dirt, which is found sooner."""
_OPAQUE_SIGMAS = 0.5
"""Number of σ beyond the loss of nearly opaque dirt: its samples before the dirt came widen σ."""
_LEAST_KNOWN = 0.3
"""Share of the blocks that must be known before dirt is searched."""
_OPAQUE = 0.55
"""Loss of light from which dirt is nearly opaque."""
_FILL_BLOCKS = 2.0
"""σ of the smoothing that bridges blocks without depth: opaque dirt on the core's window hides the surface."""
_LEAST_CAMERAS = 3
"""Number of cameras at a point from which their median tells which of them is dark."""
_UNKNOWN_FACTOR = 2.5
"""Factor of the limit before the light of clean windows is known: shading of the scene remains."""
_ROUNDS = 5
"""Rounds of reweighting of the robust fit."""
_PER_LIGHT = 0.2
"""Relative error of the volume per share of a picture's light that dirt takes."""
_HARMLESS = 0.01
"""Share of the light taken by dirt below which the volume is not affected by more than 0.2 %: only a warning."""


@dataclass(frozen=True, slots=True, eq=False)
class LightMap:
    """Light of one camera's blocks over the median camera's, as sums over frames; `GRID`."""

    logarithm: Float32Array
    """Sum of the logarithms."""
    square: Float32Array
    """Sum of their squares."""
    count: Float32Array
    """Number of samples."""

    def mean(self, least: float) -> Float32Array:
        """Return the mean logarithm; NaN in blocks with fewer than ``least`` samples."""
        enough = self.count >= least
        return np.where(enough, self.logarithm / np.maximum(self.count, 1e-3), np.nan).astype(np.float32)

    def sigma(self) -> Float32Array:
        """Return one standard deviation of the mean; successive frames show the same material three times."""
        count = np.maximum(self.count, 1)
        variance = np.maximum(self.square / count - (self.logarithm / count) ** 2, 0)
        return np.sqrt(3 * variance / count).astype(np.float32)


def sample_light(
    levels: Mapping[str, Float32Array], rig: Rig, rays: NDArray[np.float64], depth: DepthMap
) -> dict[str, LightMap]:
    """Return the light of one frame: every surface point's level in each camera over the median of all cameras.

    ``levels`` are grids of `ImageStatistics`; ``rays`` are those of `compute_block_rays`.
    """
    points, names = _locate_blocks(depth, rig, rays), [name for name in levels if name in rig.cameras]
    blocks = {name: _project_blocks(points, rig, name) for name in names}
    logs = np.stack([_sample(np.log(np.maximum(levels[name], 0.5)), blocks[name]) for name in names])
    seen = np.isfinite(logs).sum(axis=0) >= _LEAST_CAMERAS
    ratios = logs[:, seen] - _compute_medians(logs[:, seen])
    return {name: _scatter(blocks[name][seen], ratio) for name, ratio in zip(names, ratios, strict=True)}


def _compute_medians(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the medians (M,) of values (N, M) along the first axis, without NaN; every column has a value."""
    ordered, columns = np.sort(values, axis=0), np.arange(values.shape[1])  # NaN come last
    count = np.isfinite(values).sum(axis=0)
    return (ordered[(count - 1) // 2, columns] + ordered[count // 2, columns]) / 2


def accumulate_light(before: LightMap | None, now: LightMap, memory: float = MEMORY) -> LightMap:
    """Return the running sums over about ``memory`` samples."""
    if before is None:
        return now
    keep = np.float32(1 - 1 / memory)
    return LightMap(
        keep * before.logarithm + now.logarithm,
        keep * before.square + now.square,
        keep * before.count + now.count,
    )


def learn_light(light: LightMap, settings: HealthSettings) -> Float32Array:
    """Return the mean light of a camera's blocks as its reference, `GRID`; strong dirt is not learned as sound."""
    mean = light.mean(_LEAST_SAMPLES)
    expected = fit_shading(light)
    limit = min(_UNKNOWN_FACTOR * settings.dirt, 0.9)
    return np.where(_find_dark(mean - expected, light, limit), expected, mean).astype(np.float32)


def check_obstruction(
    camera: str,
    light: LightMap,
    recent: LightMap,
    reference: Float32Array | None,
    settings: HealthSettings,
) -> Finding:
    """Return the finding "dirt": the share of a camera's picture that lacks light at fixed places, percent.

    ``light`` is summed with `MEMORY`, ``recent`` with `SHORT_MEMORY`; ``reference`` is the light of clean windows,
    and without it only dirt that stands out from the shading of the scene is found.
    """
    limit = settings.dirt if reference is not None else min(_UNKNOWN_FACTOR * settings.dirt, 0.9)
    finding = Finding(DIRT, float("nan"), float("nan"), 100 * settings.dirt_area, "%", camera)
    mean = light.mean(_LEAST_SAMPLES)
    if np.isfinite(mean).mean() < _LEAST_KNOWN:
        return finding
    expected = fit_shading(light) if reference is None else reference
    change, new = mean - expected, recent.mean(_LEAST_SHORT) - expected
    dark, opaque = _find_dark(change, light, limit), _find_dark(new, recent, _OPAQUE, _OPAQUE_SIGMAS)
    loss = np.where(opaque, np.fmin(new, change), change)
    dark |= opaque
    area = float(dark.mean())
    taken = float(np.where(dark, 1 - np.exp(np.minimum(np.nan_to_num(loss), 0)), 0).mean())
    finding = replace(finding, value=100 * area, sigma=100 / dark.size)
    if area < settings.dirt_area:
        return finding
    return replace(
        finding,
        text=make_message("dirt", subject=camera, area=round(100 * area, 1), taken=round(100 * taken / area)),
        effect="none" if taken < _HARMLESS else "degraded",
        relative_sigma=_PER_LIGHT * taken,
        place=find_place(dark),
    )


def _find_dark(change: Float32Array, light: LightMap, limit: float, sigmas: float = 2.0) -> NDArray[np.bool_]:
    """Return the blocks that are darker than expected by more than the limit and ``sigmas``."""
    if np.isfinite(change).mean() < _LEAST_KNOWN:
        return np.zeros(GRID, np.bool_)
    relative = change - np.float32(compute_median(drop_nan(change)))
    return remove_single_blocks(np.nan_to_num(relative + sigmas * light.sigma()) < np.log(1 - limit))


def fit_shading(light: LightMap) -> Float32Array:
    """Return the robust quadratic surface through the light of a camera's blocks, `GRID`."""
    mean = light.mean(_LEAST_SAMPLES)
    rows, columns = np.meshgrid(*(np.linspace(-1, 1, n) for n in GRID), indexing="ij")
    terms = np.stack([np.ones(GRID), rows, columns, rows * columns, rows**2, columns**2], axis=-1).reshape(
        -1, 6
    )
    values, weights = mean.ravel().astype(np.float64), np.isfinite(mean).ravel().astype(np.float64)
    filled = np.nan_to_num(values)
    fitted = np.zeros_like(filled)
    for _ in range(_ROUNDS):
        weighted = terms * weights[:, None]
        solution = np.linalg.solve(weighted.T @ terms + 1e-6 * np.eye(6), weighted.T @ filled)
        fitted = terms @ solution
        residual = np.abs(filled - fitted)
        weights = np.where(np.isfinite(values), 1 / np.maximum(residual, 0.03), 0.0)
    return fitted.reshape(GRID).astype(np.float32)


def compute_block_rays(rig: Rig) -> NDArray[np.float64]:
    """Return x/z, y/z of the centres of the core's blocks, `GRID` + (2,)."""
    core = rig.core_camera
    width, height = compute_block_size(core.size_px)
    v, u = np.meshgrid((np.arange(GRID[0]) + 0.5) * height, (np.arange(GRID[1]) + 0.5) * width, indexing="ij")
    return core.undistort(np.stack([u, v], axis=-1))


def _locate_blocks(depth: DepthMap, rig: Rig, ideal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the surface points (N, 3) at the centres of the core's blocks, mm; NaN far from measured blocks."""
    core = rig.core_camera
    pixels = np.nan_to_num(np.rint(ideal * core.focal_px + core.center_px), nan=-1).astype(np.intp)
    rows, columns = (np.clip(pixels[..., axis], 0, core.size_px[axis] - 1) for axis in (1, 0))
    values = depth.depth_mm[rows, columns].astype(np.float32)
    known = np.isfinite(values).astype(np.float32)
    total = cv2.GaussianBlur(np.nan_to_num(values), (0, 0), _FILL_BLOCKS)
    weight = cv2.GaussianBlur(known, (0, 0), _FILL_BLOCKS)
    smooth = np.where(weight > 0.02, total / np.maximum(weight, 1e-3), np.nan)
    distance = np.where(known > 0, values, smooth).astype(np.float64)
    points = np.concatenate([ideal * distance[..., None], distance[..., None]], axis=-1)
    return points.reshape(-1, 3)


def _project_blocks(points: NDArray[np.float64], rig: Rig, name: str) -> NDArray[np.float32]:
    """Return the place of points in a camera's grid, (N, 2) column and row, block centres at whole numbers."""
    camera = rig.cameras[name]
    pixels = camera.project(rig.cam_from_core[name].apply(points))
    return (pixels / compute_block_size(camera.size_px) - 0.5).astype(np.float32)


def _sample(grid: Float32Array, places: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return a grid's values (N,) at places, linearly interpolated; NaN outside."""
    return np.asarray(
        cv2.remap(
            grid,
            np.nan_to_num(places[None, :, 0], nan=-9),
            np.nan_to_num(places[None, :, 1], nan=-9),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        ),
        np.float64,
    )[0]


def _scatter(places: NDArray[np.float32], values: NDArray[np.float64]) -> LightMap:
    """Return the sums of values (N,) in the blocks nearest to their places."""
    good = np.isfinite(values)
    columns, rows = np.rint(np.nan_to_num(places[good])).astype(np.intp).T
    cells = np.clip(rows, 0, GRID[0] - 1) * GRID[1] + np.clip(columns, 0, GRID[1] - 1)
    sums = [
        np.bincount(cells, weights, GRID[0] * GRID[1]).reshape(GRID).astype(np.float32)
        for weights in (values[good], values[good] ** 2, np.ones(int(good.sum())))
    ]
    return LightMap(*sums)
