"""Features of a cell's neighbourhood for the outline network: curvature at several scales, and openness.

All lengths are in cells, so the features do not depend on the unit of length, nor on rotation by quarter turns or
mirroring of the raster.

The raster is coarser than the depth map and has heights in cell widths, so that lumps appear alike for every rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.core.height_map import HeightMap

_MIN_WEIGHT = 0.02
"""Share of measured cells in a window from which an unmeasured cell is interpolated."""


@dataclass(frozen=True, slots=True, eq=False)
class Raster:
    """A depth map reduced by a whole factor; R × C cells of ``factor`` × ``factor`` pixels."""

    depth_mm: NDArray[np.float64]
    """(R, C) depth, with holes filled from the measured cells around them."""
    measured: NDArray[np.bool_]
    """(R, C) whether any pixel of the cell was measured."""
    height_px: NDArray[np.float32]
    """(R, C) height towards the camera, in widths of a cell on the surface."""
    rays: NDArray[np.float64]
    """(R, C, 2) x/z, y/z of the cells' centres."""
    factor: int
    """Pixels per cell, along both axes."""
    cell_rad: float
    """Width of a cell over its depth."""
    beyond: NDArray[np.bool_]
    """(R, C) cells that end the view: a lump beside them is cut."""

    @property
    def points_mm(self) -> NDArray[np.float64]:
        """Return the points (R, C, 3) in the core camera's frame."""
        depth = self.depth_mm[..., None]
        return np.concatenate([self.rays * depth, depth], axis=-1)


def make_raster(depth: DepthMap, camera: Camera, pixels: int) -> Raster | None:
    """Reduce a depth map to about ``pixels`` cells; return None where nothing is measured.

    A cell takes the lower median of its pixels' depths, which at a step is that of the upper surface.
    """
    rows, columns = depth.depth_mm.shape
    factor = max(1, int(np.ceil(np.sqrt(rows * columns / pixels) - 0.05)))
    high, wide = rows // factor, columns // factor
    block = depth.depth_mm[: high * factor, : wide * factor].reshape(high, factor, wide, factor)
    block = np.sort(
        block.transpose(0, 2, 1, 3).reshape(high, wide, factor * factor), axis=-1
    )  # NaN goes last
    number = np.isfinite(block).sum(axis=-1)
    middle = np.maximum((number - 1) // 2, 0)[..., None]
    value = np.take_along_axis(block, middle, axis=-1)[..., 0]
    measured = number > 0
    if not measured.any():
        return None
    filled = fill_gaps(value, measured)
    cell_rad = factor / float(camera.focal_px.mean())
    cell_mm = float(np.median(value[measured])) * cell_rad
    at = camera.rays()[: high * factor, : wide * factor]
    rays = at.reshape(high, factor, wide, factor, 2).mean(axis=(1, 3))
    return Raster(
        filled.astype(np.float64),
        measured,
        (-filled / np.float32(cell_mm)),
        rays,
        factor,
        cell_rad,
        find_beyond(measured, _WIDEST_SHADOW_MM / cell_mm),
    )


_WIDEST_SHADOW_MM = 40.0
"""Gaps up to this width are shadows in the view, also where they join up to its border: those of lumps of 80 mm under
light from 25 to 30° off the vertical."""


def find_beyond(measured: NDArray[np.bool_], widest_cells: float) -> NDArray[np.bool_]:
    """Return the unmeasured cells (R, C) that end the view: gaps at the border of the frame.

    Shadows between lumps join up, and with few cameras reach from the border to its middle. Only what a disc
    ``widest_cells`` wide, moved within unmeasured cells and from outside the frame, covers of a gap ends the view.
    """
    radius = max(round(widest_cells / 2), 1)
    gaps = np.pad(~measured, 2 * radius, constant_values=True)
    room = ndimage.distance_transform_edt(gaps) > radius
    reached, _ = ndimage.label(room)
    outside = ndimage.distance_transform_edt(reached != reached[0, 0]) <= radius
    inner = slice(2 * radius, -2 * radius)
    return outside[inner, inner] & ~measured


DISTANCE_MM = 1e6
"""Distance of the virtual camera over a height map: so far away that its rays are parallel to 0.001."""


def make_height_raster(heights: HeightMap) -> Raster | None:
    """Return a height map as a raster under a virtual camera far above its middle; None where all is NaN.

    Filled heights count as surface, since they continue what was measured beside them; NaN is where the view ends.
    """
    known = np.isfinite(heights.height_mm)
    if not known.any():
        return None
    height = fill_gaps(heights.height_mm.astype(np.float32), known)
    x, y = ((places - places.mean()) / DISTANCE_MM for places in (heights.x_mm, heights.y_mm))
    # y is upwards in the image, so that the rows keep their order
    rays = np.stack(np.meshgrid(x, -y), axis=-1)
    return Raster(
        depth_mm=DISTANCE_MM - height.astype(np.float64),
        measured=known,
        height_px=height / np.float32(heights.cell_mm),
        rays=rays,
        factor=1,
        cell_rad=heights.cell_mm / DISTANCE_MM,
        beyond=~known,
    )


def fill_gaps(value: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Fill unknown cells (R, C) by Gaussian means of known ones, with the narrowest Gaussian that reaches any.

    Normalised convolution, Knutsson & Westin 1993, 10.1109/CVPR.1993.341081.
    """
    middle = np.float32(np.median(value[known]))
    whole = np.where(known, value, middle)
    left = ~known
    weight = known.astype(np.float32)
    offset = np.where(known, value - middle, 0).astype(np.float32)
    sigma = 1.0
    while left.any() and sigma < 4 * max(value.shape):
        total, share = blur(offset, sigma), blur(weight, sigma)
        reached = left & (share > _MIN_WEIGHT)
        whole[reached] = middle + total[reached] / share[reached]
        left &= ~reached
        sigma *= 2
    return whole.astype(np.float32)


def blur(values: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Return the Gaussian mean; wide Gaussians are computed on a coarser grid to save time."""
    if sigma <= 16:
        return np.asarray(
            cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101), np.float32
        )
    step = int(sigma // 8)
    small = (max(values.shape[1] // step, 1), max(values.shape[0] // step, 1))
    coarse = cv2.resize(values, small, interpolation=cv2.INTER_AREA)
    coarse = cv2.GaussianBlur(coarse, (0, 0), sigma / step, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(cv2.resize(coarse, values.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


_SCALES = (1.0, 2.0, 4.0, 8.0)
"""Gaussian σ, in cells, of the smoothing before the curvatures."""
_AXES = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Directions (rows, columns) of chords and horizons."""
_STEPS = (1, 2, 3, 4, 6, 8, 12, 16, 24)
"""Distances, in cells, at which heights are read along a direction."""
_CHORDS = (2, 4, 8, 16)
"""Distances at which the middle is compared with the chord."""
_HORIZONS = (8, 24)
"""Distances within which rise and fall are searched."""

Plane = NDArray[np.float32]


def compute_features(height_px: Plane, measured: NDArray[np.bool_]) -> dict[str, Plane]:
    """Return the features (R, C) by name, from heights (R, C) without holes and the measured cells."""
    filtered = np.asarray(cv2.medianBlur(height_px, 3), np.float32)
    features: dict[str, Plane] = {}
    for scale in _SCALES:
        features |= _compute_curvature(filtered, scale)
    features |= _compute_openness(blur(filtered, 0.8))
    missing = (~measured).astype(np.float32)
    features |= {f"missing within {sigma:g}": blur(missing, sigma) for sigma in (1.5, 5.0)}
    return features | {"roughness": _compress(5 * blur(np.abs(filtered - blur(filtered, 1.0)), 3.0))}


def _compress(values: NDArray[np.floating]) -> Plane:
    """Return values compressed to -1..1, so that the size of large values does not matter."""
    return np.asarray(values / np.sqrt(1 + values * values), np.float32)


def _compute_curvature(height: Plane, scale: float) -> dict[str, Plane]:
    """Return the larger and the smaller principal second derivative and the slope, smoothed at a scale."""
    smooth = np.pad(blur(height, scale), 1, mode="edge")
    middle = smooth[1:-1, 1:-1]
    right, left, below, above = smooth[1:-1, 2:], smooth[1:-1, :-2], smooth[2:, 1:-1], smooth[:-2, 1:-1]
    xx, yy = right + left - 2 * middle, below + above - 2 * middle
    xy = (smooth[2:, 2:] + smooth[:-2, :-2] - smooth[2:, :-2] - smooth[:-2, 2:]) / 4
    mean, spread = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    factor = np.float32(1.5 * scale)
    slope = np.hypot(right - left, below - above) / 2
    return {
        f"larger curvature at {scale:g}": _compress((mean + spread) * factor),
        f"smaller curvature at {scale:g}": _compress((mean - spread) * factor),
        f"slope at {scale:g}": _compress(slope),
    }


def _compute_openness(height: Plane) -> dict[str, Plane]:
    """Return, along four axes, the height of chords over the cell, and the openness in both directions of the axis.

    Openness is the steepest rise and fall, after Yokoyama et al. 2002 (Photogramm. Eng. Remote Sens. 68(3)), by axis.
    """
    reach = max(_STEPS)
    wide = np.pad(height, reach, mode="reflect" if min(height.shape) > reach else "edge")
    rows, columns = height.shape
    chords: dict[int, list[Plane]] = {step: [] for step in _CHORDS}
    rises: dict[int, list[Plane]] = {step: [] for step in _HORIZONS}
    falls: dict[int, list[Plane]] = {step: [] for step in _HORIZONS}
    for down, right in _AXES:
        length = float(np.hypot(down, right))
        rise = [np.full(height.shape, -np.inf, np.float32) for _ in range(2)]
        fall = [np.full(height.shape, np.inf, np.float32) for _ in range(2)]
        for step in _STEPS:
            cells = max(1, round(step / length))
            slopes: list[Plane] = []
            for side, sign in enumerate((1, -1)):
                top, left = reach + sign * cells * down, reach + sign * cells * right
                slope = wide[top : top + rows, left : left + columns] - height
                slope *= np.float32(1 / (cells * length))
                np.maximum(rise[side], slope, out=rise[side])
                np.minimum(fall[side], slope, out=fall[side])
                slopes.append(slope)
            if step in chords:
                chords[step].append(slopes[0] + slopes[1])
            if step in rises:
                rises[step].append(np.minimum(*rise))
                falls[step].append(-np.maximum(*fall))
    features: dict[str, Plane] = {}
    for step, planes in chords.items():
        features[f"highest chord over {step}"] = _compress(_compute_maximum(planes))
        features[f"lowest chord over {step}"] = _compress(_compute_minimum(planes))
    for step in _HORIZONS:
        for name, planes in (("rise", rises[step]), ("fall", falls[step])):
            mean = sum(planes[1:], planes[0]) / np.float32(len(planes))
            features[f"greatest {name} within {step}"] = _compress(_compute_maximum(planes))
            features[f"mean {name} within {step}"] = _compress(mean)
            features[f"least {name} within {step}"] = _compress(_compute_minimum(planes))
    return features


def _compute_maximum(planes: Sequence[Plane]) -> Plane:
    return np.maximum(np.maximum(planes[0], planes[1]), np.maximum(planes[2], planes[3]))


def _compute_minimum(planes: Sequence[Plane]) -> Plane:
    return np.minimum(np.minimum(planes[0], planes[1]), np.minimum(planes[2], planes[3]))
