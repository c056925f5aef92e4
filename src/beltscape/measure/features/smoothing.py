"""A model of the matcher's smoothing: its last fits and its twicing, applied to a surface of known shape."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig
from beltscape.kernels import Kernels, load_on_processor

MATCHER_REACH_PX = 7.0
"""Distance from a step up to which the matcher's windows mix both sides, at the reference width."""
_WIDTH_PX = 1224
"""Reference width of the matcher's window sizes (`stereo.multiview.frame`)."""


def compute_camera_scale(camera: Camera) -> float:
    """Return the scale of a camera's image over the reference width; the matcher's windows grow with it."""
    return compute_width_scale(camera.size_px[0])


def compute_width_scale(width_px: int) -> float:
    """Return the scale of a grid of this width."""
    return float(np.clip(width_px / _WIDTH_PX, 0.5, 1.8))


Map = NDArray[np.float32]

_LEVELS_PX = 7
"""Radius of the matcher's window of normalised levels, here and below as in `stereo.multiview.frame`."""
_NOISE_LEVELS, _FLOOR, _MODEL = 1.2 / 255, 4.0 / 255**2, 2e-3
"""Image noise, variance floor and model variance that the matcher finds in images of normal exposure."""
_NARROW_PX, _FIRM_PX, _WIDE_PX = (1.5, 2.5), (4.0,), (2.5, 5.0)
"""The matcher's windows of least squares."""
_AROUND_PX, _MOST_PX = 7.0, 0.1
"""Parameters of the twicing: the window in which its gain is compared with noise, and the largest gain."""
_MOST_RADIUS_PX = 15
"""Largest radius of the matcher's windows."""
_BLUR_PX = 0.39
"""Gaussian sigma by which the images blur the surface: 0.6 px of lens and pixel for a point of light, half of that
for the rim of a disc. Fitted between the two to simulated spheres at 1224 and 612 px."""


@dataclass(frozen=True, slots=True)
class Passes:
    """The matcher's last passes, as defined in `stereo.settings` and `stereo.multiview.frame`."""

    fits: tuple[tuple[float, tuple[float, ...]], ...]
    """(tolerance px, Gaussian sigmas px of the windows) of each fit, in order."""
    twicing: bool


_STANDARD = Passes(((1.0, _NARROW_PX), (0.25, _WIDE_PX)), twicing=True)
"""``standard``."""
_FAST = Passes(((0.7, _NARROW_PX), (0.3, _WIDE_PX)), twicing=False)
"""``fast``, on blocks of 2 × 2 pixels where images are large."""


@dataclass(frozen=True, slots=True, eq=False)
class Smoothing:
    """The matcher's smoothing in one frame."""

    information: NDArray[np.float32]
    """(h, w) 1/px² information of each pixel of the matcher's grid about its own depth."""
    step: int
    """Image pixels per side of a pixel of that grid."""
    scale: float
    """Scale of the windows relative to those for a grid as wide as the paper's images, halved."""
    focal_baseline: float
    """Focal length (px of the grid) times the mean baseline (mm): inverse depth in px is this over depth."""
    passes: Passes

    def smooth(self, depth_mm: NDArray[np.float64], window: tuple[slice, slice]) -> NDArray[np.float64]:
        """Return the smoothed depth (h, w) of a surface in a window that begins on whole blocks.

        ``depth_mm`` (h, w) is the surface's depth at every image pixel of the window, NaN beside the surface.
        """
        true = _average_blocks(self.focal_baseline / depth_mm, self.step)
        rows, columns = (slice(part.start // self.step, part.stop // self.step) for part in window)
        information = np.where(np.isfinite(true), self.information[rows, columns], 0).astype(np.float32)
        blurred = _blur(true, _BLUR_PX / self.step)
        information = np.where(np.isfinite(blurred), information, 0).astype(np.float32)
        shown = np.where(np.isfinite(blurred), blurred, true).astype(np.float32)
        return self.focal_baseline / _expand_planes(
            *self._apply_passes(shown, information, load_on_processor()), self.step
        )

    def expand_information(self, window: tuple[slice, slice]) -> NDArray[np.float64]:
        """Return the information (h, w) of the image pixels in a window that begins on whole blocks."""
        rows, columns = (slice(part.start // self.step, part.stop // self.step) for part in window)
        information = np.kron(self.information[rows, columns], np.ones((self.step, self.step)))
        return np.asarray(information, np.float64)

    def without_twicing(self) -> Smoothing:
        """Return the smoothing without twicing, which gives the full flattening by the windows."""
        return replace(self, passes=replace(self.passes, twicing=False))

    def _apply_passes(self, true: Map, information: Map, kernels: Kernels) -> tuple[Map, Map, Map]:
        """Return inverse depth and its slopes after all passes, from the true inverse depth (h, w) px."""
        s, slopes = true, [np.gradient(true, axis=axis).astype(np.float32) for axis in (1, 0)]
        tolerance = 1.0
        for tolerance, sigmas_px in self.passes.fits:
            pull = np.nan_to_num(information * (true - s))
            fit = kernels.local_fit(
                information, pull, s, *slopes, radii=self.radii(sigmas_px), tolerance=tolerance, threads=1
            )
            s, slopes = np.asarray(fit.s, np.float32), [fit.slope_u, fit.slope_v]
        if not self.passes.twicing:
            return s, slopes[0], slopes[1]
        pull, firm_radii = np.nan_to_num(information * (true - s)), self.radii(_FIRM_PX)
        fit = kernels.local_fit(
            information, pull, s, *slopes, radii=firm_radii, tolerance=tolerance, flatten=0.0, threads=1
        )
        share = self._compute_twicing_share(fit.s - s, fit.variance)
        s, *slopes = (
            np.asarray(old + share * (new - old), np.float32)
            for old, new in zip((s, *slopes), (fit.s, fit.slope_u, fit.slope_v), strict=True)
        )
        return s, slopes[0], slopes[1]

    def _compute_twicing_share(self, gain: Map, variance: NDArray[np.floating]) -> Map:
        """Return the share (h, w) of the twicing's gain that the matcher adds: signal over signal and noise.

        The gain of a model has no noise, whereas the matcher's energy contains both.
        """
        side = (2 * int(_AROUND_PX * self.scale / 2) + 1,) * 2
        energy = cv2.blur(np.minimum(np.nan_to_num(gain) ** 2, _MOST_PX**2), side)
        noise = cv2.blur(np.minimum(np.nan_to_num(variance), _MOST_PX**2).astype(np.float32), side)
        return np.asarray(energy / np.maximum(energy + noise, np.float32(1e-12)), np.float32)

    def radii(self, sigmas_px: tuple[float, ...]) -> tuple[tuple[int, float], ...]:
        """Return windows (radius px, Gaussian sigma px) on this grid."""
        scaled = [sigma * self.scale for sigma in sigmas_px]
        return tuple((min(_MOST_RADIUS_PX, int(np.ceil(2 * sigma))), sigma) for sigma in scaled)


def estimate_smoothing(image: NDArray[np.floating], depth: DepthMap, rig: Rig) -> Smoothing:
    """Return the smoothing of a depth map that was matched on an image (H, W) of its grid.

    Blocks of equal confidence indicate ``fast``; on small images ``fast`` and ``standard`` have the same grid.
    """
    step = detect_grid_step(depth)
    grid = _average_blocks(image, step)
    scale = compute_width_scale(grid.shape[1])
    information = compute_information(grid, scale, len(rig.auxiliaries)).astype(np.float32)
    passes = _STANDARD if step == 1 else _FAST
    return Smoothing(information, step, scale, _compute_focal_baseline(rig) / step, passes)


def detect_grid_step(depth: DepthMap) -> int:
    """Return 2 for a depth map matched on blocks of 2 × 2 pixels, whose confidence is constant in a block, else 1."""
    blocks = depth.confidence[: depth.confidence.shape[0] // 2 * 2, : depth.confidence.shape[1] // 2 * 2]
    first = blocks[::2, ::2]
    alike = all(np.array_equal(first, blocks[v::2, u::2]) for v, u in ((0, 1), (1, 0), (1, 1)))
    return 2 if alike and np.ptp(first) > 0 else 1


def compute_information(
    image: NDArray[np.floating], scale: float, auxiliaries: int = 4
) -> NDArray[np.float64]:
    """Return the information (H, W) 1/px² of each pixel of an image about its own depth.

    It is the gradient's energy of locally normalised grey levels over their noise, as in the matcher's weights: the
    rims of dots count, the dark between them does not. Half of the auxiliaries are assumed along each axis.
    """
    value = image.astype(np.float64) / max(float(np.quantile(image, 0.999)), 1e-9)
    side = 2 * max(round(_LEVELS_PX * scale), 1) + 1
    mean = cv2.blur(value, (side, side))
    variance = np.maximum(cv2.blur(value * value, (side, side)) - mean**2, 0) + _FLOOR
    slope_u, slope_v = (cv2.Scharr(value, cv2.CV_64F, *axes) / 32 for axes in ((1, 0), (0, 1)))
    noise = 2 * _NOISE_LEVELS**2 / variance + _MODEL
    return auxiliaries / 2 * (slope_u**2 + slope_v**2) / variance / noise


def _compute_focal_baseline(rig: Rig) -> float:
    """Return focal length (px) times the auxiliaries' mean baseline (mm)."""
    baselines = [float(np.linalg.norm(rig.cam_from_core[name].center_mm)) for name in rig.auxiliaries]
    camera: Camera = rig.core_camera
    return float(camera.focal_px.mean()) * (float(np.mean(baselines)) if baselines else 300.0)


def _average_blocks(values: NDArray[np.floating], step: int) -> Map:
    """Return the mean (H / step, W / step) of whole blocks; NaN where a part of a block is."""
    height, width = (n // step for n in values.shape)
    cut = values[: height * step, : width * step].reshape(height, step, width, step)
    return cut.mean(axis=(1, 3), dtype=np.float64).astype(np.float32)


def _blur(values: Map, sigma_px: float) -> NDArray[np.float64]:
    """Return (h, w) values blurred by a Gaussian; NaN where it reaches beyond them."""
    there = np.isfinite(values)
    inside = cv2.erode(there.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) > 0
    blurred = cv2.GaussianBlur(np.where(there, values, 0).astype(np.float64), (3, 3), sigma_px)
    return np.where(inside, blurred, np.nan)


def _expand_planes(s: Map, slope_u: Map, slope_v: Map, step: int) -> NDArray[np.float64]:
    """Return inverse depth (h · step, w · step) in the blocks' px, every block a plane."""
    inside = (np.arange(step) - (step - 1) / 2) / step
    v, u = np.meshgrid(inside, inside, indexing="ij")
    whole = np.ones((step, step))
    return np.kron(s.astype(np.float64), whole) + np.kron(slope_u, u) + np.kron(slope_v, v)
