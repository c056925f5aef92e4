"""The empty belt as a floor under every frame's load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.belt import HeightMap
from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.core.errors import MeasureError
from beltscape.measure.belt import Belt
from beltscape.measure.box import seen_box
from beltscape.measure.flow.layer import Layer, closed
from beltscape.measure.surface import Grid, Surface, height_map, pixel_size_mm, visible_step_mm
from beltscape.measure.trust import trusted

Range = tuple[float, float]
_CALM_MM = 12.0
"""The empty belt's deviation from its even shape is averaged about so far: noise goes, what the rig bends stays."""
_WELL = 0.85
"""The window ends where rows are measured less well than that share of the best ones."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Where the empty belt is, as seen in place; the load is what lies over it."""

    belt: Belt
    camera: Camera
    """Whose depth maps are to be measured."""
    grid: Grid
    """A grid over the view that stands still; its columns are those of all layers."""
    off_mm: NDArray[np.float64]
    """(Ny, Nx) on that grid: the empty belt over its even cross-section, calmed; 0 far from where it was seen."""
    raised: float
    """Factor from the σ that depth maps claim to the scatter on the even belt, at least 1."""
    seen_mm: Range
    """Reach of the view along y."""
    window_mm: Range
    """The part of it that is measured well all across the belt."""

    @property
    def cell_mm(self) -> float:
        """Edge of a cell."""
        return self.grid.cell_mm

    @property
    def patch_mm2(self) -> float:
        """Area over which a depth map's errors go together."""
        return (self.belt.correlation_px * self.cell_mm) ** 2

    def load(self, depth: DepthMap, grid: Grid) -> Surface:
        """Load over the empty belt on any grid; what is not trustworthy is NaN."""
        pixel_mm, step_mm = pixel_size_mm(depth, self.camera), visible_step_mm(depth, self.camera)
        use = trusted(depth, pixel_mm, step_mm, self.belt.correlation_px)
        top = height_map(depth, self.camera, self.belt.belt_from_core, grid, use)
        height = top.heights.height_mm - self.floor_mm(grid)
        # what lies well below the empty belt is no surface
        good = height > -(10 * self.belt.noise_mm + 3 * self.cell_mm)
        parts = (height, self.raised * top.heights.sigma_mm, self.raised * top.noise_mm)
        height, sigma, noise = (np.where(good, part, np.nan) for part in parts)
        return Surface(HeightMap(height, sigma, grid.origin_mm, grid.cell_mm), noise)

    def layer(self, depth: DepthMap, position_mm: float, direction: int, blur_mm: float) -> Layer:
        """A frame's load in belt coordinates, s = position - direction · y (direction: +1 or -1).

        ``blur_mm`` is one standard deviation of the position: what may be misplaced counts less in the fusion.
        """
        cell = self.cell_mm
        low, high = sorted(position_mm - direction * y for y in self.seen_mm)
        first, last = int(np.ceil(low / cell)), int(np.floor(high / cell))
        start = min(direction * (position_mm - row * cell) for row in (first, last))
        grid = Grid((self.grid.origin_mm[0], start), cell, (last - first + 1, self.grid.shape[1]))
        load = self.load(depth, grid)
        worse = 1 + blur_mm / cell
        parts = (load.heights.height_mm, worse * load.heights.sigma_mm, worse * load.noise_mm)
        height, sigma, noise = (part[::-direction].astype(np.float32) for part in parts)
        return Layer(first, height, sigma, noise, closed(np.isfinite(height)).mean(axis=1))

    def coarse(self, depth: DepthMap, cells: int) -> NDArray[np.float64]:
        """(n, m) load on a grid that stands still, ``cells`` times coarser, for finding the motion."""
        step = cells * self.cell_mm
        shape = tuple((side - 1) // cells + 1 for side in self.grid.shape)
        return self.load(depth, Grid(self.grid.origin_mm, step, (shape[0], shape[1]))).heights.height_mm

    def floor_mm(self, grid: Grid) -> NDArray[np.float64]:
        """(Ny, Nx) height of the empty belt on any grid."""
        columns = (grid.x_mm - self.grid.origin_mm[0]) / self.cell_mm
        rows = (grid.y_mm - self.grid.origin_mm[1]) / self.cell_mm
        places = np.meshgrid(rows, columns, indexing="ij")
        off = ndimage.map_coordinates(self.off_mm, places, order=1, mode="nearest")
        return self.belt.height_mm(grid.x_mm)[None] + off


def find_ground(
    empty: DepthMap, empty_camera: Camera, belt: Belt, camera: Camera, cell_mm: float | None = None
) -> Ground:
    """The floor for depth maps of ``camera``, from the empty belt as ``empty_camera`` saw it.

    Both are the rig's core camera; their images may differ in size. Cells are a pixel of ``camera`` on the belt.

    Raises
    ------
    MeasureError
        if the belt was seen on too short a stretch.
    """
    box = seen_box(empty, empty_camera, belt)
    cell = cell_mm or float(np.nanmedian(empty.depth_mm)) / float(camera.focal_px.mean())
    grid = Grid.over(box.across_mm, box.along_mm, cell)
    pixel_mm, step_mm = pixel_size_mm(empty, empty_camera), visible_step_mm(empty, empty_camera)
    use = trusted(empty, pixel_mm, step_mm, belt.correlation_px)
    bottom = height_map(empty, empty_camera, belt.belt_from_core, grid, use).heights.height_mm
    off = bottom - belt.height_mm(grid.x_mm)[None]
    sound = np.abs(off) <= 6 * belt.noise_mm + cell
    claimed = float(np.median(empty.sigma_mm[empty.measured]))
    return Ground(
        belt=belt,
        camera=camera,
        grid=grid,
        off_mm=_calmed(off, sound, _CALM_MM / cell),
        raised=max(1.0, belt.noise_mm / max(claimed, 1e-9)),
        seen_mm=(float(grid.y_mm[0]), float(grid.y_mm[-1])),
        window_mm=_window(sound, grid),
    )


def _calmed(off: NDArray[np.float64], sound: NDArray[np.bool_], blur: float) -> NDArray[np.float64]:
    """Weighted mean of the sound cells about each cell, fading to zero far from any."""
    value = ndimage.gaussian_filter(np.where(sound, off, 0.0), blur)
    weight = ndimage.gaussian_filter(sound.astype(np.float64), blur)
    return value / (weight + 1e-3)


def _window(sound: NDArray[np.bool_], grid: Grid) -> Range:
    """From the first to the last of the rows that are measured nearly as well as the best."""
    share = ndimage.uniform_filter1d(sound.mean(axis=1), max(1, round(10.0 / grid.cell_mm)))
    rows = np.flatnonzero(share >= _WELL * np.quantile(share, 0.9))
    if len(rows) < 2 or not share.any():
        raise MeasureError(
            "empty belt: measured on too short a stretch to be a floor; give a frame in which it is seen well"
        )
    return float(grid.y_mm[rows[0]]), float(grid.y_mm[rows[-1]])
