"""The texture that each camera shows at the points of a depth map, and its displacement by correlation.

Textures are sampled on one grid of the core's view. Moving texture is displaced between two cameras and two instants.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet, Image, to_grey
from beltscape.core.geometry.rig import Rig
from beltscape.core.statistics import compute_median, drop_nan

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
class SampledSurface:
    """The surface of one frame on the grid."""

    points_mm: NDArray[np.float64]
    """(H, W, 3) points in the core's frame; NaN: not measured."""
    is_smooth: NDArray[np.bool_]
    """(H, W) whether a point is measured and away from steps of the depth."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSamples:
    """What `SurfaceView` makes of one frame; another process may have made it."""

    surface: SampledSurface
    textures: Mapping[str, Texture]
    """The filtered image of each camera."""
    own: Mapping[str, Texture]
    """The textures at the points of the surface."""


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

    def keep(self, frames: FrameSet, depth: DepthMap, samples: SurfaceSamples) -> None:
        """Let `view` return for this frame what was made of it elsewhere."""
        self._last = SurfaceView(self, frames, depth, samples)

    @property
    def cells_per_unit(self) -> float:
        """Return the number of cells per length at a distance of 1: the focal length in cells."""
        return float(self._focal_cells.mean())

    def locate_surface(self, depth: DepthMap) -> SampledSurface:
        """Return the surface of a depth map of the core."""
        part = slice(self._step // 2, None, self._step)
        measured = depth.depth_mm[part, part].astype(np.float32)
        filled = _fill_small_holes(measured)
        points = self.rays * filled[..., None].astype(np.float64)
        width = np.float32(compute_median(drop_nan(measured))) / self.cells_per_unit
        kernel = np.ones((_AROUND, _AROUND), np.uint8)
        farthest: NDArray[np.float32] = cv2.dilate(np.nan_to_num(filled, nan=np.inf), kernel)
        nearest: NDArray[np.float32] = cv2.erode(np.nan_to_num(filled, nan=-np.inf), kernel)
        with np.errstate(invalid="ignore"):
            is_smooth = np.isfinite(filled) & (farthest - nearest < _STEEP * width)
        return SampledSurface(points, is_smooth)

    def filter_texture(self, image: Image) -> Texture:
        """Return the band-passed texture of an image over its local level; it is reduced to two pixels per cell."""
        grey, times = to_grey(image), self._reduction
        if times > 1:
            size = grey.shape[1] // times, grey.shape[0] // times
            grey = cv2.resize(grey[: size[1] * times, : size[0] * times], size, interpolation=cv2.INTER_AREA)
        cell = self._step / times
        fine: Texture = cv2.GaussianBlur(grey, (0, 0), _FINE * cell)
        coarse = _blur_widely(grey, _COARSE * cell)
        return np.asarray((fine - coarse) / np.maximum(coarse, 1.0), np.float32)

    def sample(self, texture: Texture, camera: str, points_mm: NDArray[np.float64]) -> Texture:
        """Return a camera's texture (H, W) at points (H, W, 3) of the core's frame; NaN outside its image."""
        return sample_at(texture, self.locate(camera, points_mm))

    def locate(self, camera: str, points_mm: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return where (2, H, W) a camera's texture shows points (H, W, 3) of the core's frame, for `sample_at`."""
        pose = self._rig.cam_from_core[camera]
        planes = np.ascontiguousarray(points_mm.reshape(-1, 3).T)
        # by rows of the rotation: NumPy's product of a stack and a transposed matrix takes seven times as long
        x, y, z = (
            row[0] * planes[0] + row[1] * planes[1] + (row[2] * planes[2] + shift)
            for row, shift in zip(pose.rotation, pose.translation_mm, strict=True)
        )
        places = np.empty((2, len(x)), np.float32)
        for axis, pixels in enumerate(self._rig.cameras[camera].project_axes(x, y, z)):
            places[axis] = (pixels + 0.5) / self._reduction - 0.5
        return np.nan_to_num(places, copy=False, nan=_OUTSIDE).reshape(2, *points_mm.shape[:2])

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
        return np.array([compute_median(drop_nan(motion[..., axis])) for axis in (0, 1)])


_OUTSIDE = -9.0
"""Coordinate outside any texture, of points without a pixel."""


def sample_at(texture: Texture, places: NDArray[np.float32]) -> Texture:
    """Return a texture (H, W) at the places (2, H, W) of `SurfaceGrid.locate`; NaN outside it."""
    x, y = places
    return np.asarray(cv2.remap(texture, x, y, cv2.INTER_LINEAR, borderValue=float("nan")), np.float32)


class SurfaceView:
    """The surface of one frame and its cameras' textures, each made when it is first used."""

    def __init__(
        self, grid: SurfaceGrid, frames: FrameSet, depth: DepthMap, samples: SurfaceSamples | None = None
    ) -> None:
        """``samples`` are those of this frame that are known already."""
        self._grid, self.frames, self.depth, self._samples = grid, frames, depth, samples
        self._textures: dict[str, Texture] = {} if samples is None else dict(samples.textures)
        self._own: dict[str, Texture] = {} if samples is None else dict(samples.own)

    @cached_property
    def surface(self) -> SampledSurface:
        """Return the surface on the grid."""
        return self._grid.locate_surface(self.depth) if self._samples is None else self._samples.surface

    def filter_textures(self, cameras: Iterable[str]) -> dict[str, Texture]:
        """Return the filtered images of those of the cameras that are in the frame."""
        names = [name for name in cameras if name in self.frames.images]
        for name in names:
            if name not in self._textures:
                self._textures[name] = self._grid.filter_texture(self.frames.images[name])
        return {name: self._textures[name] for name in names}

    def sample_surface(self, cameras: Iterable[str]) -> SurfaceSamples:
        """Return the surface, the filtered images of those cameras, and their textures on the surface."""
        textures = self.filter_textures(cameras)
        rest = {name: texture for name, texture in textures.items() if name not in self._own}
        self._own |= self._grid.sample_all(rest, self.surface.points_mm)
        return SurfaceSamples(self.surface, textures, {name: self._own[name] for name in textures})


_BLURRED_PX = 3.0
"""σ of the wide blur on the reduced image that it is made of; results differ by 0.4 % of the levels on average."""


def _blur_widely(grey: Texture, sigma_px: float) -> Texture:
    """Return the image under a wide Gaussian, by way of a smaller image: a tenth of the time."""
    times = max(1, int(sigma_px / _BLURRED_PX))
    if times == 1:
        return np.asarray(cv2.GaussianBlur(grey, (0, 0), sigma_px), np.float32)
    height, width = grey.shape
    size = max(1, width // times), max(1, height // times)
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(small, (0, 0), sigma_px * size[0] / width)
    return np.asarray(cv2.resize(blurred, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


def _fill_small_holes(depth_mm: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return depths (H, W), and next to measured ones the weighted mean of the surroundings instead of NaN."""
    known = np.isfinite(depth_mm).astype(np.float32)
    total = cv2.GaussianBlur(np.nan_to_num(depth_mm), (0, 0), _BRIDGED)
    weight = cv2.GaussianBlur(known, (0, 0), _BRIDGED)
    mean = np.where(weight > 0.05, total / np.maximum(weight, 1e-3), np.nan)
    return np.where(known > 0, depth_mm, mean).astype(np.float32)


_SEARCH_CELLS = 24
"""Largest displacement that is searched, in cells of the grid: some 50 mm."""
_STATIC_SHARE = 0.4
"""The search ends at this share of the travel: a projected pattern stands still and is displaced by all of it."""
_LEAST_COMPARED = 0.05
"""Least share of the grid that must be compared."""


@dataclass(frozen=True, slots=True)
class Displacement:
    """Displacement of an auxiliary's texture against the core's, positive along the travel."""

    moving_mm: float
    """Displacement of what moves with the belt, seen by the two cameras at different instants."""
    across_mm: float
    """Its displacement across the travel: 0 for cameras that agree with the rig, early or late."""
    same_mm: float
    """Of the texture at one and at the other instant: a projected pattern, which stands still, contributes to it."""
    correlation: float
    """Least correlation of the moving texture."""


def measure_displacement(
    grid: SurfaceGrid,
    before: SurfaceSamples,
    now: SurfaceSamples,
    travel_mm: NDArray[np.float64],
    core: str,
    auxiliaries: tuple[str, ...],
) -> dict[str, Displacement]:
    """Return the displacement of each auxiliary against the core, from two frames.

    Four displacements are averaged: of the core before to the auxiliary now and back, on the surface of either
    frame. An error of the travel, shadows that move over the material, and errors of the depth cancel.

    Parameters
    ----------
    grid
        The grid of both frames.
    before, now
        The frames.
    travel_mm
        (3,) motion of the belt between them in the core's frame.
    core, auxiliaries
        Names of cameras that both frames have.
    """
    later = grid.sample_all(
        {name: now.textures[name] for name in (core, *auxiliaries)}, before.surface.points_mm + travel_mm
    )
    earlier = grid.sample_all(
        {name: before.textures[name] for name in (core, *auxiliaries)}, now.surface.points_mm - travel_mm
    )
    length = float(np.linalg.norm(travel_mm))
    along = grid.compute_image_direction(now.surface.points_mm, travel_mm / length)
    window = int(min(_SEARCH_CELLS, _STATIC_SHARE * length * np.linalg.norm(along)))
    first, last = before.surface.is_smooth, now.surface.is_smooth
    result: dict[str, Displacement] = {}
    for name in auxiliaries:
        peaks = [
            find_peak(before.own[core], later[name], first, window),
            find_peak(before.own[name], later[core], first, window),
            find_peak(now.own[core], earlier[name], last, window),
            find_peak(now.own[name], earlier[core], last, window),
        ]
        signs = np.array([1.0, -1.0, 1.0, -1.0])
        mean = (signs[:, None] * np.array([peak[0] for peak in peaks])).mean(axis=0)
        at_rest = (
            find_peak(before.own[core], before.own[name], first, window)[0],
            find_peak(now.own[core], now.own[name], last, window)[0],
        )
        same = 0.5 * (at_rest[0] + at_rest[1])
        scale = float(along @ along)
        result[name] = Displacement(
            float(mean @ along) / scale,
            float(mean @ (-along[1], along[0])) / scale,
            float(same @ along) / scale,
            min(peak[1] for peak in peaks),
        )
    return result


def correlate_at_rest(
    one: Texture, other: Texture, where: NDArray[np.bool_], least_share: float = _LEAST_COMPARED
) -> float:
    """Return the normalised correlation of two textures without displacement; 0 where too little is seen by both."""
    seen = where & np.isfinite(one) & np.isfinite(other)
    if seen.mean() < least_share:
        return 0.0
    return float(np.corrcoef(one[seen], other[seen])[0, 1])


def find_peak(
    one: Texture, other: Texture, where: NDArray[np.bool_], window: int, least_share: float = _LEAST_COMPARED
) -> tuple[NDArray[np.float64], float]:
    """Return displacement (2,), column and row, of ``other`` against ``one``, and the correlation there.

    ``where`` selects the compared texture of ``one``, at least ``least_share`` of the grid. Without a peak inside the
    window the correlation is 0.
    """
    none = np.zeros(2), 0.0
    seen = where & np.isfinite(one) & np.isfinite(other)
    if seen.mean() < least_share or window < 2:
        return none
    is_known = np.isfinite(other)
    selected = np.where(seen, one - one[seen].mean(), 0).astype(np.float32)
    searched = np.where(is_known, other - other[seen].mean(), 0).astype(np.float32)
    surface = _correlate(selected, searched, window)
    surface /= max(float(np.sqrt((selected**2).sum() * (searched[seen] ** 2).sum())), 1e-9)
    row, column = np.unravel_index(int(surface.argmax()), surface.shape)
    if not (0 < row < 2 * window and 0 < column < 2 * window):
        return none
    value = float(surface[row, column])
    offset = (
        column - window + _refine(surface[row, column - 1 : column + 2]),
        row - window + _refine(surface[row - 1 : row + 2, column]),
    )
    return np.array(offset), value


def _correlate(one: Texture, other: Texture, window: int) -> NDArray[np.float64]:
    """Return the sums of products (2·window + 1, 2·window + 1) over displacements of ``other`` up to ``window``."""
    shape = [fft.next_fast_len(side + window, real=True) for side in one.shape]
    spectrum = np.conj(fft.rfft2(one, shape)) * fft.rfft2(other, shape)
    sums = np.asarray(fft.irfft2(spectrum, shape), np.float64)
    side = 2 * window + 1
    return np.roll(sums, (window, window), (0, 1))[:side, :side]


def _refine(three: NDArray[np.float64]) -> float:
    """Return the vertex of the parabola through three values, from the middle one."""
    low, middle, high = (float(value) for value in three)
    bend = low - 2 * middle + high
    return 0.5 * (low - high) / bend if bend < 0 else 0.0
