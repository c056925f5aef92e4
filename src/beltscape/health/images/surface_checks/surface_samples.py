"""The texture that each camera shows at the points of a depth map, on one grid of the core's view."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet, Image, to_grey
from beltscape.core.geometry.rig import Rig

Texture = NDArray[np.float32]
_COLUMNS = 306
"""Approximate number of columns of the grid; more give no better correlation of the moving texture."""
_FINE, _COARSE = 0.75, 6.0
"""Gaussians, in cells of the grid, between which texture is compared: shading is coarser, noise is finer."""
_BRIDGED = 1.5
"""Gaussian, in cells, that fills small holes of the depth map; holes in both images would correlate at offset 0."""
_STEEP = 7.5
"""Greatest difference of depth within `_AROUND` cells, in cells' widths: beside steps the cameras see other surfaces,
which biases the delay (75 mm of travel: 0.18 to 0.1 mm; 150 mm: 0.5 to 0.15 mm)."""
_AROUND = 5
"""Edge of the square of cells in which a step of the depth excludes the middle one: the support of `_FINE`."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The surface of one frame on the grid."""

    points_mm: NDArray[np.float64]
    """(H, W, 3) points in the core's frame; NaN: not measured."""
    is_smooth: NDArray[np.bool_]
    """(H, W) whether a point is measured and away from steps of the depth."""


class SurfaceGrid:
    """The grid of the core's view, and the cameras' textures on it."""

    def __init__(self, rig: Rig) -> None:
        self._rig, core = rig, rig.core_camera
        self._step = max(1, round(core.size_px[0] / _COLUMNS))
        self._reduction = max(1, self._step // 2)
        columns, rows = (np.arange(self._step // 2, size, self._step) for size in core.size_px)
        pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
        ideal = (pixels - core.center_px) / core.focal_px
        self.rays = np.concatenate([ideal, np.ones((*ideal.shape[:2], 1))], axis=-1)
        """(H, W, 3) rays of the grid in the core's frame, z = 1."""
        self._focal_cells = core.focal_px / self._step
        self._last: SurfaceView | None = None

    def view(self, frames: FrameSet, depth: DepthMap) -> SurfaceView:
        """Return the surface and textures of a frame; the same ones for all checks of the last frame."""
        if self._last is None or self._last.frames is not frames or self._last.depth is not depth:
            self._last = SurfaceView(self, frames, depth)
        return self._last

    @property
    def cells_per_unit(self) -> float:
        """Return the number of cells per length at a distance of 1: the focal length in cells."""
        return float(self._focal_cells.mean())

    def locate_surface(self, depth: DepthMap) -> Surface:
        """Return the surface of a depth map of the core."""
        part = slice(self._step // 2, None, self._step)
        measured = depth.depth_mm[part, part].astype(np.float32)
        filled = _fill_small_holes(measured)
        points = self.rays * filled[..., None].astype(np.float64)
        width = np.nanmedian(measured) / self.cells_per_unit if measured.size else np.nan
        kernel = np.ones((_AROUND, _AROUND), np.uint8)
        farthest: NDArray[np.float32] = cv2.dilate(np.nan_to_num(filled, nan=np.inf), kernel)  # pyright: ignore
        nearest: NDArray[np.float32] = cv2.erode(np.nan_to_num(filled, nan=-np.inf), kernel)  # pyright: ignore
        with np.errstate(invalid="ignore"):
            is_smooth = np.isfinite(filled) & (farthest - nearest < _STEEP * width)
        return Surface(points, is_smooth)

    def filter_texture(self, image: Image) -> Texture:
        """Return the band-passed texture of an image over its local level; it is reduced to two pixels per cell."""
        grey, times = to_grey(image), self._reduction
        if times > 1:
            size = grey.shape[1] // times, grey.shape[0] // times
            grey = cv2.resize(grey[: size[1] * times, : size[0] * times], size, interpolation=cv2.INTER_AREA)
        cell = self._step / times
        fine: Texture = cv2.GaussianBlur(grey, (0, 0), _FINE * cell)  # pyright: ignore[reportAssignmentType]
        coarse: Texture = cv2.GaussianBlur(grey, (0, 0), _COARSE * cell)  # pyright: ignore[reportAssignmentType]
        return np.asarray((fine - coarse) / np.maximum(coarse, 1.0), np.float32)

    def sample(self, texture: Texture, camera: str, points_mm: NDArray[np.float64]) -> Texture:
        """Return a camera's texture (H, W) at points (H, W, 3) of the core's frame; NaN outside its image."""
        pixels = self._rig.cameras[camera].project(self._rig.cam_from_core[camera].apply(points_mm))
        reduced = (pixels + 0.5) / self._reduction - 0.5
        x, y = np.nan_to_num(reduced.astype(np.float32), nan=-9.0).transpose(2, 0, 1)
        sampled = cv2.remap(texture, x, y, cv2.INTER_LINEAR, borderValue=float("nan"))
        return np.asarray(sampled, np.float32)

    def sample_all(
        self, textures: Mapping[str, Texture], points_mm: NDArray[np.float64]
    ) -> dict[str, Texture]:
        """Return the textures of all cameras at points of the core's frame."""
        return {name: self.sample(texture, name, points_mm) for name, texture in textures.items()}

    def compute_image_direction(
        self, points_mm: NDArray[np.float64], along: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the median motion (2,) on the grid, cells per mm of travel along ``along`` (3,): column, row."""
        z = points_mm[..., 2:]
        motion = (along[:2] - points_mm[..., :2] / z * along[2]) / z * self._focal_cells
        return np.asarray(np.nanmedian(motion.reshape(-1, 2), axis=0), np.float64)


class SurfaceView:
    """The surface of one frame and its cameras' textures, each made when it is first used."""

    def __init__(self, grid: SurfaceGrid, frames: FrameSet, depth: DepthMap) -> None:
        self._grid, self.frames, self.depth = grid, frames, depth
        self._textures: dict[str, Texture] = {}

    @cached_property
    def surface(self) -> Surface:
        """Return the surface on the grid."""
        return self._grid.locate_surface(self.depth)

    def filter_textures(self, cameras: Iterable[str]) -> dict[str, Texture]:
        """Return the filtered images of those of the cameras that are in the frame."""
        names = [name for name in cameras if name in self.frames.images]
        for name in names:
            if name not in self._textures:
                self._textures[name] = self._grid.filter_texture(self.frames.images[name])
        return {name: self._textures[name] for name in names}


def _fill_small_holes(depth_mm: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return depths (H, W), and next to measured ones the weighted mean of the surroundings instead of NaN."""
    known = np.isfinite(depth_mm).astype(np.float32)
    total = cv2.GaussianBlur(np.nan_to_num(depth_mm), (0, 0), _BRIDGED)
    weight = cv2.GaussianBlur(known, (0, 0), _BRIDGED)
    mean = np.where(weight > 0.05, total / np.maximum(weight, 1e-3), np.nan)
    return np.where(known > 0, depth_mm, mean).astype(np.float32)
