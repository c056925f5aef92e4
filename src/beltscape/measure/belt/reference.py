"""The empty belt as the reference surface of a moving belt's load, and the core camera's view of it.

A layer is the load of one frame over it, on the grid that moves with the belt.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt
from beltscape.core.errors import MeasureError
from beltscape.core.geometry.camera import Camera
from beltscape.measure.surface import Grid, close_pinholes
from beltscape.measure.volume.load import compute_load_heights, find_reliable_pixels
from beltscape.measure.volume.uncertainty import compute_false_height_mm


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Rows of belt measured by one frame; row j is at belt coordinate s = j · cell."""

    first: int
    """Number of the first row."""
    height_mm: NDArray[np.float32]
    """(n, Nx) load over the empty belt; NaN where not measured."""
    sigma_mm: NDArray[np.float32]
    """(n, Nx) σ of ``height_mm``."""
    noise_mm: NDArray[np.float32]
    """(n, Nx) the part of σ that neighbouring cells share."""

    share: NDArray[np.float64]
    """(n,) share of each row that was measured, the pinholes between neighbouring points included."""
    ray_slope: NDArray[np.float64]
    """(n,) slope of the core's rays from the vertical, positive towards larger s."""
    false_mm: float = 0.0
    """σ of the mean height from depths that may be false, common to all rows."""
    frame: int = 0
    """Number of the frame since the start."""

    @property
    def end(self) -> int:
        """Return the number of the row after the last one."""
        return self.first + len(self.height_mm)

    def leave_out(self, cells: NDArray[np.bool_]) -> Layer:
        """Return the layer without some cells (n, Nx)."""
        height, sigma, noise = (
            np.where(cells, np.float32(np.nan), plane)
            for plane in (self.height_mm, self.sigma_mm, self.noise_mm)
        )
        lost = (cells & np.isfinite(self.height_mm)).mean(axis=1)
        return replace(
            self, height_mm=height, sigma_mm=sigma, noise_mm=noise, share=np.maximum(self.share - lost, 0.0)
        )

    def rows(self, first: int, end: int) -> Layer:
        """Return the part of the layer that lies in a range of rows."""
        part = slice(max(first, self.first) - self.first, max(min(end, self.end) - self.first, 0))
        return Layer(
            max(first, self.first),
            self.height_mm[part],
            self.sigma_mm[part],
            self.noise_mm[part],
            self.share[part],
            self.ray_slope[part],
            self.false_mm,
            frame=self.frame,
        )


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLoad:
    """The load of one frame on the static grid of the view, y ascending."""

    height_mm: NDArray[np.float32]
    """(Ny, Nx) load over the empty belt; NaN where not measured."""
    sigma_mm: NDArray[np.float32]
    """(Ny, Nx) σ of ``height_mm``."""
    noise_mm: NDArray[np.float32]
    """(Ny, Nx) the part of σ that neighbouring cells share."""
    share: NDArray[np.float64]
    """(Ny,) share of each row that was measured, the pinholes between neighbouring points included."""
    false_mm: float = 0.0
    """σ of the mean height from depths that may be false."""


Range = tuple[float, float]
_WHOLE = 0.9
"""Share of the belt's width that must lie in the core's image within the window in which strips are cut."""
_OTHER_SIZE_PX = 0.06
"""Systematic difference of the mean height between two image sizes, in pixels of the smaller images on the belt: 0.04
and 0.03 on two rigs of five and three cameras at 612 and 306 px, 0.06 on a third; it does not average out."""
_TRIALS = 64
"""Positions over the belt's width that are tried as ends of what is measured of a belt wider than the view."""
_WORTH = 0.6
"""The whole width is measured where this share of the largest area in view remains; straight views keep 0.9."""

LEAST_CONFIDENCE = 0.7
"""Pixels with a lower confidence are excluded; other frames or the filling of holes replace them.

On a simulated heap the preset fast bridges hollows beside rocks by 13 mm on average, and a quarter to a third of its
pixels below this limit are wrong by more than 5 mm. Its totals of three simulated heaps differ from standard's by
+0.94, +0.58 and +1.44 % at 0.5, by +0.21, -0.15 and +0.72 % at 0.65, by -0.08, -0.45 and +0.42 % at 0.7. The
presets standard and fine measure no such pixel.
"""
_SAMPLED = 3
"""Every third pixel of a row and of a column tells how high the depths of a frame are that may be false."""
_AROUND_MM, _TALLER = 40.0, 1.3
"""Load outside the image may be taller than the visible load within this distance, by up to this factor."""


@dataclass(frozen=True, slots=True, eq=False)
class EmptyBeltReference:
    """The empty belt, the core camera, and the ranges of the belt in its view."""

    belt: Belt
    camera: Camera
    """Camera of the depth maps to be measured."""
    grid: Grid
    """Static grid over the view; all layers share its columns."""
    seen_mm: Range
    """Range of the view along y."""
    window_mm: Range
    """Part of the view in which the belt is visible across its width: where strips begin and end."""

    @property
    def cell_mm(self) -> float:
        """Return the edge of a cell."""
        return self.grid.cell_mm

    @property
    def patch_mm2(self) -> float:
        """Return the correlation area of a depth map's errors."""
        return (self.belt.correlation_px * self.cell_mm) ** 2

    @property
    def other_size_mm(self) -> float:
        """Return σ of the mean height between the belt as learned and as measured now, where image sizes differ."""
        learned = self.belt.camera
        if learned is None or learned.size_px[0] == self.camera.size_px[0]:
            return 0.0
        distance = float(self.belt.belt_from_core.inverse().translation_mm[2])
        return (
            _OTHER_SIZE_PX
            * distance
            / min(float(learned.focal_px.mean()), float(self.camera.focal_px.mean()))
        )

    def measure_load(self, depth: DepthMap) -> MeasuredLoad:
        """Return a frame's load on the static grid, by reliable pixels of sufficient confidence.

        It depends on the frame alone, wherever the belt is; `place` puts it on the belt.
        """
        reliable = find_reliable_pixels(_confident(depth), self.camera, self.belt)
        load = compute_load_heights(depth, self.camera, self.belt, self.grid, reliable)
        whole = self._top_in_view(load.height_mm)
        share = (close_pinholes(np.isfinite(load.height_mm)) & whole).mean(axis=1)
        height, sigma, noise = (plane.astype(np.float32) for plane in load)
        for plane in (height, sigma, noise):
            plane[~whole] = np.nan
        return MeasuredLoad(height, sigma, noise, share, self._estimate_false_height(depth))

    def place(self, load: MeasuredLoad, position_mm: float, direction: int, blur_mm: float = 0.0) -> Layer:
        """Return a load at a position of the belt: s = position - direction · y (direction: +1 or -1).

        Between two rows of the static grid it is interpolated; beside an unmeasured cell the nearer row counts.
        ``blur_mm`` is one standard deviation of the position; a less certain position reduces the weight in fusion.
        """
        cell, (_, start) = self.cell_mm, self.grid.origin_mm
        end = start + cell * (self.grid.shape[0] - 1)
        low = (position_mm - direction * (end if direction > 0 else start)) / cell
        first, turn = int(np.ceil(low)), slice(None, None, -direction)
        height, sigma, noise = (
            _interpolate_rows(plane[turn], first - low)
            for plane in (load.height_mm, load.sigma_mm, load.noise_mm)
        )
        worse = np.float32(1 + blur_mm / cell)
        share, ray_slope = load.share[turn][:-1], -direction * _mean_ray_slope(self)[turn][:-1]
        return Layer(first, height, worse * sigma, worse * noise, share, ray_slope, load.false_mm)

    def _estimate_false_height(self, depth: DepthMap) -> float:
        """Return σ of a frame's mean height from depths that may be false, by a sample of its pixels.

        Its share of the measured cells alone counts: holes have a σ of their own.
        """
        sample = _thin(depth, _SAMPLED)
        points = self.belt.belt_from_core.apply(sample.points_mm(_thin_camera(self.camera, sample, _SAMPLED)))
        across, _, up = np.moveaxis(points, -1, 0)
        used = np.isfinite(up) & (sample.confidence >= LEAST_CONFIDENCE)
        used &= (across >= self.belt.across_mm[0]) & (across <= self.belt.across_mm[1])
        height = up - self.belt.height_mm(across)
        return compute_false_height_mm(height, sample.confidence, used, _SAMPLED * self.cell_mm)

    def coarse(self, depth: DepthMap, times: int) -> NDArray[np.float64]:
        """Return the load (n, m) on the static grid with cells and pixels ``times`` coarser, for registration."""
        fewer = _thin(depth, times)
        thinned = _thin_camera(self.camera, fewer, times)
        shape = tuple((side - 1) // times + 1 for side in self.grid.shape)
        grid = Grid(self.grid.origin_mm, times * self.cell_mm, (shape[0], shape[1]))
        return compute_load_heights(fewer, thinned, self.belt, grid).height_mm

    def refine(self, cells: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Return cells (n, m) of the grid of `coarse` on a layer's rows and columns, y ascending."""
        times = max(1, round(self.grid.shape[1] / cells.shape[1]))
        rows, columns = (
            np.minimum(np.arange(count) // times, side - 1)
            for count, side in zip(shape, cells.shape, strict=True)
        )
        return cells[np.ix_(rows, columns)]

    def _top_in_view(self, height_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return the cells (Ny, Nx) over which a surface as high as the load around them is also in the image.

        Along the image's border only the foot of tall objects is in the image, which is not the top surface.
        """
        side = 2 * round(_AROUND_MM / self.cell_mm) + 1
        height = np.nan_to_num(height_mm).astype(np.float32)  # OpenCV dilates float64 five times slower
        about = cv2.dilate(height, np.ones((side, side), np.uint8))
        return is_in_image(self.belt, self.camera, self.grid, _TALLER * np.maximum(about, 0.0))

    def depths_mm(self) -> Range:
        """Return the nearest and farthest depth of the empty belt within the view."""
        x, y = np.meshgrid(self.grid.x_mm, self.grid.y_mm)
        z = self.belt.surface_mm(self.grid.x_mm, self.grid.y_mm)
        depth = self.belt.belt_from_core.inverse().apply(np.stack([x, y, z], axis=-1))[..., 2]
        return float(depth.min()), float(depth.max())

    def ray_slope_across(self) -> NDArray[np.float64]:
        """Return the rays' slope (Nx,) in x, at the belt's height."""
        eye = self.belt.belt_from_core.translation_mm
        return (self.grid.x_mm - eye[0]) / np.maximum(eye[2] - self.belt.height_mm(self.grid.x_mm), 1.0)


def _thin(depth: DepthMap, times: int) -> DepthMap:
    """Return every ``times``-th pixel of a depth map."""
    part = slice(None, None, times)
    return DepthMap(
        depth.depth_mm[part, part],
        depth.sigma_mm[part, part],
        depth.views[part, part],
        depth.confidence[part, part],
    )


def _thin_camera(camera: Camera, fewer: DepthMap, times: int) -> Camera:
    """Return the camera of every ``times``-th pixel."""
    rows, columns = fewer.depth_mm.shape
    return replace(
        camera,
        size_px=(columns, rows),
        focal_px=camera.focal_px / times,
        center_px=camera.center_px / times,
    )


def _interpolate_rows(plane: NDArray[np.float32], part: float) -> NDArray[np.float32]:
    """Return (n - 1, m) values between the rows of a plane (n, m), at this part of the way to the next row."""
    before, after = plane[:-1], plane[1:]
    values = np.asarray(before + np.float32(part) * (after - before), np.float32)
    np.copyto(values, before if part < 0.5 else after, where=np.isnan(values))
    return values


@lru_cache(maxsize=2)
def _mean_ray_slope(reference: EmptyBeltReference) -> NDArray[np.float64]:
    """Return the rays' slope (Ny,) in y, which is constant across, except for the belt's shape."""
    eye, grid = reference.belt.belt_from_core.translation_mm, reference.grid
    reach = np.maximum(eye[2] - reference.belt.surface_mm(grid.x_mm, grid.y_mm), 1.0)
    return ((grid.y_mm[:, None] - eye[1]) / reach).mean(axis=1)


def make_reference(belt: Belt, camera: Camera, cell_mm: float | None = None) -> EmptyBeltReference:
    """Return the reference for depth maps of ``camera``, the rig's core; cells are its pixels on the belt.

    The belt may have been measured with images of another size. Of a belt that is wider than the view of a camera
    turned against it, the part is measured that is longest in view for its width.

    Raises
    ------
    MeasureError
        if the belt is nowhere visible across its width.
    """
    distance = float(belt.belt_from_core.inverse().translation_mm[2])
    cell = cell_mm or distance / float(camera.focal_px.mean())
    belt = _narrow_to_view(belt, camera)
    grid = Grid.over(belt.across_mm, belt.along_mm, cell)
    return EmptyBeltReference(
        belt, camera, grid, (float(grid.y_mm[0]), float(grid.y_mm[-1])), _window(belt, camera, grid)
    )


def _confident(depth: DepthMap) -> DepthMap:
    """Return the depth map without pixels of low confidence."""
    unsure = ~(depth.confidence >= LEAST_CONFIDENCE)
    depth_mm, sigma_mm = depth.depth_mm.astype(np.float32), depth.sigma_mm.astype(np.float32)
    depth_mm[unsure] = sigma_mm[unsure] = np.nan
    return replace(depth, depth_mm=depth_mm, sigma_mm=sigma_mm)


def is_in_image(
    belt: Belt, camera: Camera, grid: Grid, above_mm: NDArray[np.float64] | float
) -> NDArray[np.bool_]:
    """Return whether points ``above_mm`` over the empty belt at the cells (Ny, Nx) are in the undistorted image."""
    x, y = grid.x_mm, grid.y_mm[:, None]
    z = belt.surface_mm(grid.x_mm, grid.y_mm) + above_mm
    core_from_belt = belt.belt_from_core.inverse()
    low, high = camera.center_px, np.array(camera.size_px) - 1 - camera.center_px
    # each border of the image is a plane through the camera's centre: points inside all four are in the image
    along, down = camera.focal_px
    planes = np.array([[along, 0, low[0]], [0, down, low[1]], [-along, 0, high[0]], [0, -down, high[1]]])
    shown = np.ones(z.shape, bool)
    for normal, offset in zip(
        planes @ core_from_belt.rotation, planes @ core_from_belt.translation_mm, strict=True
    ):
        shown &= normal[2] * z >= -((normal[0] * x + offset) + normal[1] * y)
    return shown


def _narrow_to_view(belt: Belt, camera: Camera) -> Belt:
    """Return the belt between ends that leave a window, where ends lie out of view and the whole width has none."""
    if belt.ends is None or "out of view" not in belt.ends:
        return belt
    cell = (belt.across_mm[1] - belt.across_mm[0]) / _TRIALS
    grid = Grid.over(belt.across_mm, belt.along_mm, cell)
    shown = np.cumsum(is_in_image(belt, camera, grid, 0.0), axis=1)
    shown = np.pad(shown, ((0, 0), (1, 0)))
    columns = grid.shape[1]

    def area(first: int, last: int) -> float:
        rows = np.flatnonzero(shown[:, last] - shown[:, first] >= _WHOLE * (last - first))
        return float((last - first) * (rows[-1] - rows[0])) if len(rows) else 0.0

    starts = range(columns // 2) if belt.ends[0] == "out of view" else (0,)
    stops = range(columns // 2 + 1, columns + 1) if belt.ends[1] == "out of view" else (columns,)
    first, last = max(((one, two) for one in starts for two in stops), key=lambda pair: area(*pair))
    if area(0, columns) >= _WORTH * area(first, last):
        return belt
    low, high = belt.across_mm
    return replace(
        belt,
        across_mm=(low + first * cell if first else low, low + (last - 1) * cell if last < columns else high),
    )


def _window(belt: Belt, camera: Camera, grid: Grid) -> Range:
    """Return the range of rows on which nearly all of the belt's width lies in the undistorted image."""
    rows = np.flatnonzero(is_in_image(belt, camera, grid, 0.0).mean(axis=1) >= _WHOLE)
    if len(rows) < 2:
        raise MeasureError(
            "empty belt: nowhere seen across its width; mount the core camera higher or turn its long side across"
        )
    return float(grid.y_mm[rows[0]]), float(grid.y_mm[rows[-1]])
