"""The height of the load over the empty belt on a grid, and integrals over the measured rectangle (box).

The integrals count partial cells exactly. The capacity of a belt is the cross-section of its full load; its middle
and the load's centroid are found as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt
from beltscape.core.errors import InputError, MeasureError
from beltscape.core.geometry.camera import Camera
from beltscape.core.height_map import BeltProfile, HeightMap
from beltscape.core.quantities import BOX_SIDE
from beltscape.measure.holes import Filled
from beltscape.measure.surface import (
    Grid,
    ReliablePixels,
    average_blocks,
    close_pinholes,
    compute_height_map,
    compute_sampling,
    reliable_mask,
)


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """Loaded minus empty height, with its σ."""

    grid: Grid
    """The cells in the belt frame."""
    height_mm: NDArray[np.float64]
    """(Ny, Nx) load over the empty belt; NaN where it was not measured."""
    sigma_mm: NDArray[np.float64]
    """(Ny, Nx) σ of ``height_mm``."""
    noise_mm: NDArray[np.float64]
    """(Ny, Nx) the part of σ that neighbouring cells share."""
    measured: NDArray[np.bool_]
    """(Ny, Nx) whether a cell was measured, the pinholes between neighbouring points included."""
    ray_slope: NDArray[np.float64]
    """(2, Ny, Nx) slope of the core's rays from the vertical, in x and y, positive away from the core."""


def find_reliable_pixels(loaded: DepthMap, camera: Camera, belt: Belt) -> ReliablePixels:
    """Return the pixels of a depth map by which a load is measured."""
    sampling = compute_sampling(loaded, camera)
    use = reliable_mask(loaded, sampling.pixel_mm, sampling.step_mm, belt.correlation_px)
    return ReliablePixels(use, sampling)


def compute_load(
    loaded: DepthMap, camera: Camera, belt: Belt, grid: Grid, reliable: ReliablePixels | None = None
) -> Load:
    """Return the load over the empty belt on a grid, from reliable pixels only.

    Where the depth map of the empty belt stated less noise than it had, σ is raised by the same factor. ``reliable``
    are the pixels to use; None: those of `find_reliable_pixels`.
    """
    heights = compute_load_heights(loaded, camera, belt, grid, reliable)
    eye = belt.belt_from_core.translation_mm
    reach = np.maximum(eye[2] - belt.surface_mm(grid.x_mm, grid.y_mm), 1.0)
    return Load(
        grid,
        heights.height_mm,
        heights.sigma_mm,
        heights.noise_mm,
        close_pinholes(np.isfinite(heights.height_mm)),
        np.stack([(grid.x_mm[None] - eye[0]) / reach, (grid.y_mm[:, None] - eye[1]) / reach]),
    )


class LoadHeights(NamedTuple):
    """The planes of a `Load`, NaN where it was not measured."""

    height_mm: NDArray[np.float64]
    sigma_mm: NDArray[np.float64]
    noise_mm: NDArray[np.float64]


def compute_load_heights(
    loaded: DepthMap, camera: Camera, belt: Belt, grid: Grid, reliable: ReliablePixels | None = None
) -> LoadHeights:
    """Return the planes of the load that `compute_load` returns, all of them (Ny, Nx)."""
    reliable = reliable or find_reliable_pixels(loaded, camera, belt)
    top = compute_height_map(loaded, camera, belt.belt_from_core, grid, reliable.use, reliable.sampling)
    height = top.heights.height_mm - belt.surface_mm(grid.x_mm, grid.y_mm)
    noise = max(1.0, belt.noise_mm / max(belt.claimed_sigma_mm, 1e-9)) * top.heights.sigma_mm
    sigma = np.sqrt(noise**2 + belt.surface_sigma_mm(grid.x_mm, grid.y_mm) ** 2)
    # a point well below the empty belt is a mismatch
    is_wrong = ~(height > -(10 * belt.noise_mm + 3 * grid.cell_mm))
    for plane in (height, sigma, noise):
        plane[is_wrong] = np.nan
    return LoadHeights(height, sigma, noise)


def average_load(load: Load, filled: Filled, side: int) -> HeightMap:
    """Return the filled load as means over blocks of ``side`` cells; σ does not fall, as errors are correlated."""
    shift = (side - 1) / 2 * load.grid.cell_mm
    origin = (load.grid.origin_mm[0] + shift, load.grid.origin_mm[1] + shift)
    sigma = np.sqrt(average_blocks(filled.sigma_mm**2, side))
    return HeightMap(average_blocks(filled.value_mm, side), sigma, origin, load.grid.cell_mm * side)


Range = tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class IntegrationWeights:
    """Integration weights of a grid's columns and rows: their outer product sums to the box's area."""

    across: NDArray[np.float64]
    """(Nx,) mm."""
    along: NDArray[np.float64]
    """(Ny,) mm."""

    def share(self, flags: NDArray[np.bool_]) -> float:
        """Return the share of the box's area where the flags (Ny, Nx) are set."""
        return float(self.along @ flags @ self.across / (self.along.sum() * self.across.sum()))


@dataclass(frozen=True, slots=True)
class Box:
    """Rectangle in the belt frame."""

    across_mm: Range
    """In x."""
    along_mm: Range
    """In y."""

    def integration_weights(self, grid: Grid) -> IntegrationWeights:
        """Return the weights of the grid's cells, exact for a surface that is linear between their centres."""
        return IntegrationWeights(
            _hat_integrals(grid.x_mm, grid.cell_mm, self.across_mm),
            _hat_integrals(grid.y_mm, grid.cell_mm, self.along_mm),
        )

    def enclose(self, across_mm: Range | None, along_mm: Range | None) -> Box:
        """Return the smallest box around this one and a requested one, refusing one that reaches too far outside."""
        return Box(
            _join_ranges("across", self.across_mm, across_mm or self.across_mm),
            _join_ranges("along", self.along_mm, along_mm or self.along_mm),
        )


def require_box_side(side: str, ends_mm: Range | None) -> None:
    """Raise InputError if a side of a requested box is too short to be in mm; None: it is not given."""
    if ends_mm is None:
        return
    low, high = ends_mm
    if high - low < BOX_SIDE.possible[0]:
        raise InputError(
            f"--{side} {low:g} {high:g}: {high - low:g} mm is no box on a belt ({BOX_SIDE.possible[0]:g} mm and more)"
            f"; in metres? write {1000 * low:g} {1000 * high:g}"
        )


def select_box(
    measured: NDArray[np.bool_], grid: Grid, across_mm: Range | None, along_mm: Range | None
) -> Box:
    """Return the given box; a side that is None becomes the range that is well measured.

    Raises
    ------
    MeasureError
        if nothing was measured in the box.
    """
    middle = slice(grid.shape[0] // 4, grid.shape[0] - grid.shape[0] // 4)
    if across_mm is None:
        across_mm = _find_measured_range(measured[middle].mean(axis=0), grid.x_mm)
    columns = (grid.x_mm >= across_mm[0]) & (grid.x_mm <= across_mm[1])
    if along_mm is None:
        along_mm = _find_measured_range(measured[:, columns].mean(axis=1), grid.y_mm)
    box = Box(across_mm, along_mm)
    if box.integration_weights(grid).share(measured) == 0:
        rows, columns = np.nonzero(measured)
        x, y = grid.x_mm[columns], grid.y_mm[rows]
        extent = (
            f"x {x.min():.0f} to {x.max():.0f} mm and y {y.min():.0f} to {y.max():.0f} mm"
            if len(x)
            else "nowhere"
        )
        raise MeasureError(
            f"box x {across_mm[0]:g} to {across_mm[1]:g} mm, y {along_mm[0]:g} to {along_mm[1]:g} mm: nothing was "
            f"measured in it; both surfaces were measured in {extent}"
        )
    return box


def compute_profiles(
    height_mm: NDArray[np.float64], measured: NDArray[np.bool_], grid: Grid, box: Box, every_mm: float
) -> list[BeltProfile]:
    """Return the mean cross-sections of equal stretches, no longer than ``every_mm``, that tile the box."""
    number = max(1, int(np.ceil((box.along_mm[1] - box.along_mm[0]) / every_mm - 1e-9)))
    ends = np.linspace(*box.along_mm, number + 1)
    result: list[BeltProfile] = []
    for start, end in pairwise(ends):
        weights = Box(box.across_mm, (float(start), float(end))).integration_weights(grid)
        own = weights.across > 0
        height = weights.along @ height_mm / weights.along.sum()
        area = float(weights.across @ height)
        middle = float(start + end) / 2
        result.append(BeltProfile(middle, grid.x_mm[own], height[own], area, weights.share(measured)))
    return result


def _hat_integrals(nodes: NDArray[np.float64], spacing: float, limits: Range) -> NDArray[np.float64]:
    """Return the integral of every node's hat function over the limits."""

    def up_to(limit: float) -> NDArray[np.float64]:
        s = np.clip((limit - nodes) / spacing, -1, 1)
        return spacing * np.where(s < 0, 0.5 * (1 + s) ** 2, 1 - 0.5 * (1 - s) ** 2)

    return up_to(limits[1]) - up_to(limits[0])


def _join_ranges(side: str, extent: Range, requested: Range) -> Range:
    low, high = requested
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise InputError(f"--{side} {low:g} {high:g}: give the lower end first, both in mm of the belt frame")
    require_box_side(side, requested)
    if high <= extent[0] or low >= extent[1]:
        raise MeasureError(
            f"--{side} {low:g} {high:g}: nothing was measured there; the belt was seen from "
            f"{extent[0]:.0f} to {extent[1]:.0f} mm"
        )
    size = extent[1] - extent[0]
    if low < extent[0] - size or high > extent[1] + size:
        raise InputError(
            f"--{side} {low:g} {high:g}: far larger than what was seen, {extent[0]:.0f} to {extent[1]:.0f} mm; "
            "give a box within it"
        )
    return min(low, extent[0]), max(high, extent[1])


def _find_measured_range(share: NDArray[np.float64], centers_mm: NDArray[np.float64]) -> Range:
    """Return the range from the first to the last row (or column) that is measured nearly as well as the best."""
    width = max(1, len(share) // 40)
    smoothed = np.convolve(np.pad(share, width, mode="edge"), np.ones(width) / width, "same")[
        width : width + len(share)
    ]
    on = np.flatnonzero((smoothed >= 0.75 * np.quantile(smoothed, 0.9)) & (smoothed > 0))
    if len(on) < 2:
        return float(centers_mm[0]), float(centers_mm[-1])
    return float(centers_mm[on[0]]), float(centers_mm[on[-1]])


_STEP_MM = 0.5
"""Step of the integration over the width."""


def compute_capacity_mm2(belt: Belt, surcharge_rad: float) -> float:
    """Return the cross-section of the fully loaded belt by DIN 22101:2011-12, section 5, on the measured shape.

    The load fills the belt's usable width and rises from both its ends at the surcharge angle to a ridge in the
    middle (A = A1 + A2 in the standard, with A1 = w²·tan β / 4 over the chord w). The usable width of a belt of
    width B along its surface, centred, is

        b = 0.9·B - 50 mm for B ≤ 2 m, b = B - 250 mm for wider belts.

    The width extends from edge to edge where both were found, else over the measured part: then the result is the
    capacity of that part, which is less than the belt's. The measured cross-section replaces DIN's straight idlers.
    It is 0 for a shape that holds no load, such as a narrow strip or a ridge.
    """
    left, right = _find_belt_ends(belt)
    x = np.linspace(left, right, max(3, int((right - left) / _STEP_MM)))
    z = belt.height_mm(x)
    run = np.r_[0.0, np.cumsum(np.hypot(np.diff(x), np.diff(z)))]
    width = float(run[-1])
    usable = 0.9 * width - 50.0 if width <= 2000.0 else width - 250.0
    if usable <= 0:
        return 0.0
    a, b = (float(np.interp(0.5 * (width + side * usable), run, x)) for side in (-1, 1))
    inside = np.linspace(a, b, max(3, int((b - a) / _STEP_MM)))
    low, high = belt.height_mm(np.array([a, b]))
    chord = low + (high - low) * (inside - a) / (b - a)
    ridge = np.minimum(inside - a, b - inside) * np.tan(surcharge_rad)
    return max(0.0, float(np.trapezoid(chord + ridge - belt.height_mm(inside), inside)))


def find_belt_middle(belt: Belt) -> tuple[float, float]:
    """Return the belt's middle in x and its σ: between its edges if both were found, else the trough's, to a node."""
    edges = belt.edges
    if edges is not None and np.isfinite(edges.left_mm) and np.isfinite(edges.right_mm):
        sigma = 0.5 * float(np.hypot(edges.left_sigma_mm, edges.right_sigma_mm))
        return 0.5 * (edges.left_mm + edges.right_mm), sigma
    return belt.middle_mm, float(np.median(np.diff(belt.x_mm)))


def compute_centroid_mm(
    weight_mm2: NDArray[np.float64], load_mm: NDArray[np.float64], position_mm: NDArray[np.float64]
) -> float:
    """Return the mean of a coordinate over the load's volume; all arguments (Ny, Nx)."""
    part = weight_mm2 * load_mm
    return float(np.sum(part * position_mm) / np.sum(part))


def _find_belt_ends(belt: Belt) -> tuple[float, float]:
    """Return the belt's edges in x where they were found, else the ends of the measured part."""
    left, right = belt.across_mm
    if belt.edges is not None:
        left = belt.edges.left_mm if np.isfinite(belt.edges.left_mm) else left
        right = belt.edges.right_mm if np.isfinite(belt.edges.right_mm) else right
    return left, right
