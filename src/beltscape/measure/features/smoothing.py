"""The matcher's smoothing of a curved surface: its last fits and its twicing, applied to a model of that surface."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.core.rig import Rig
from beltscape.kernels import Kernels, load
from beltscape.measure.features.view import scale_of_width

Map = NDArray[np.float32]

_LEVELS_PX = 7
_NOISE_LEVELS, _FLOOR, _MODEL = 1.2 / 255, 4.0 / 255**2, 2e-3
_NARROW_PX, _FIRM_PX, _WIDE_PX = (1.5, 2.5), (4.0,), (2.5, 5.0)
_AROUND_PX, _MOST_PX = 7.0, 0.1
"""Of the twicing: the window in which its gain is compared with noise, and the largest gain."""
_MOST_RADIUS_PX = 15
_BLUR_PX = 0.39
"""Gaussian sigma by which images blur the surface that they show: σ of the lens and the pixel (0.6 px) for a point of
light, 1/2 of that for the rim of a disc. Fitted to simulated spheres at 1224 and 612 px between the two."""


@dataclass(frozen=True, slots=True)
class Passes:
    """The matcher's last passes; `beltscape.stereo.multiview.settings` and `beltscape.stereo.multiview.frame.windows` define them."""

    fits: tuple[tuple[float, tuple[float, ...]], ...]
    """(tolerance px, Gaussian sigmas px of the windows) of each fit, in order."""
    twicing: bool


_STANDARD = Passes(((1.0, _NARROW_PX), (0.4, _FIRM_PX), (0.25, _WIDE_PX)), twicing=True)
"""``standard``; the additional iterations of ``fine`` change little."""
_FAST = Passes(((0.7, _NARROW_PX), (0.3, _WIDE_PX)), twicing=False)
"""``fast``, on blocks of 2 × 2 pixels where images are large."""


@dataclass(frozen=True, slots=True, eq=False)
class Smoothing:
    """What the matcher does to a surface in one frame."""

    information: NDArray[np.float32]
    """(h, w) 1/px² of each pixel of the matcher's grid: how well it alone determines its depth."""
    step: int
    """Image pixels per side of a pixel of that grid."""
    scale: float
    """By which the windows are larger than those for a grid as wide as the paper's images, halved."""
    focal_baseline: float
    """Focal length (px of the grid) times the mean baseline (mm): inverse depth in px is this over depth."""
    passes: Passes

    def smooth(self, depth_mm: NDArray[np.float64], window: tuple[slice, slice]) -> NDArray[np.float64]:
        """Return the depth (h, w) that the matcher makes of a surface in a window that begins on whole blocks.

        NaN beside the surface, whose depth (h, w) mm is that of every image pixel of the window.
        """
        true = _blocks(self.focal_baseline / depth_mm, self.step)
        rows, columns = (slice(part.start // self.step, part.stop // self.step) for part in window)
        known = np.where(np.isfinite(true), self.information[rows, columns], 0).astype(np.float32)
        seen = _blurred(true, _BLUR_PX / self.step)
        known = np.where(np.isfinite(seen), known, 0).astype(np.float32)
        shown = np.where(np.isfinite(seen), seen, true).astype(np.float32)
        return self.focal_baseline / _planes(*self._matched(shown, known, load()), self.step)

    def of_pixels(self, window: tuple[slice, slice]) -> NDArray[np.float64]:
        """Return the information (h, w) of the image pixels in such a window."""
        rows, columns = (slice(part.start // self.step, part.stop // self.step) for part in window)
        known = np.kron(self.information[rows, columns], np.ones((self.step, self.step)))
        return np.asarray(known, np.float64)

    def untwiced(self) -> Smoothing:
        """Return the same without twicing: what windows flatten before it is put back."""
        return replace(self, passes=replace(self.passes, twicing=False))

    def _matched(self, true: Map, known: Map, kernels: Kernels) -> tuple[Map, Map, Map]:
        """Return inverse depth and its slopes after all passes, from an inverse depth (h, w) px that is right."""
        s, slopes = true, [np.gradient(true, axis=axis).astype(np.float32) for axis in (1, 0)]
        tolerance = 1.0
        for tolerance, sigmas_px in self.passes.fits:
            pull = np.nan_to_num(known * (true - s))
            fit = kernels.local_fit(
                known, pull, s, *slopes, radii=self.radii(sigmas_px), tolerance=tolerance, threads=1
            )
            s, slopes = np.asarray(fit.s, np.float32), [fit.slope_u, fit.slope_v]
        if not self.passes.twicing:
            return s, slopes[0], slopes[1]
        pull, firm = np.nan_to_num(known * (true - s)), self.radii(_FIRM_PX)
        fit = kernels.local_fit(
            known, pull, s, *slopes, radii=firm, tolerance=tolerance, flatten=0.0, threads=1
        )
        share = self._share(fit.s - s, fit.variance)
        s, *slopes = (
            np.asarray(old + share * (new - old), np.float32)
            for old, new in zip((s, *slopes), (fit.s, fit.slope_u, fit.slope_v), strict=True)
        )
        return s, slopes[0], slopes[1]

    def _share(self, gain: Map, variance: NDArray[np.floating]) -> Map:
        """Return the share (h, w) of the twicing's gain that the matcher adds: signal over signal and noise.

        The gain of a model has no noise; in the matcher's energy both are in.
        """
        side = (2 * int(_AROUND_PX * self.scale / 2) + 1,) * 2
        energy = cv2.blur(np.minimum(np.nan_to_num(gain) ** 2, _MOST_PX**2), side)
        noise = cv2.blur(np.minimum(np.nan_to_num(variance), _MOST_PX**2).astype(np.float32), side)
        return np.asarray(energy / np.maximum(energy + noise, np.float32(1e-12)), np.float32)

    def radii(self, sigmas_px: tuple[float, ...]) -> tuple[tuple[int, float], ...]:
        """Return windows (radius px, Gaussian sigma px) on this grid."""
        scaled = [sigma * self.scale for sigma in sigmas_px]
        return tuple((min(_MOST_RADIUS_PX, int(np.ceil(2 * sigma))), sigma) for sigma in scaled)


def smoothing_of(image: NDArray[np.floating], depth: DepthMap, rig: Rig) -> Smoothing:
    """Return the smoothing of a depth map that was matched by an image (H, W) on its grid.

    Blocks show the grid of ``fast``; on small images ``fast`` and ``standard`` have the same grid.
    """
    step = grid_step(depth)
    grid = _blocks(image, step)
    scale = scale_of_width(grid.shape[1])
    known = information(grid, scale, len(rig.auxiliaries)).astype(np.float32)
    passes = _STANDARD if step == 1 else _FAST
    return Smoothing(known, step, scale, _focal_baseline(rig) / step, passes)


def grid_step(depth: DepthMap) -> int:
    """Return 2 for a depth map matched on blocks of 2 × 2 pixels, whose confidence is the same all over a block."""
    blocks = depth.confidence[: depth.confidence.shape[0] // 2 * 2, : depth.confidence.shape[1] // 2 * 2]
    first = blocks[::2, ::2]
    alike = all(np.array_equal(first, blocks[v::2, u::2]) for v, u in ((0, 1), (1, 0), (1, 1)))
    return 2 if alike and np.ptp(first) > 0 else 1


def information(image: NDArray[np.floating], scale: float, auxiliaries: int = 4) -> NDArray[np.float64]:
    """Return (H, W) 1/px²: how well each pixel of an image by itself determines its depth.

    The gradient's energy after levels were normalised in a window, over their noise, as the matcher weighs pixels:
    dots' rims count, the dark between them does not. Auxiliaries stand all around, half of them along each axis.
    """
    value = image.astype(np.float64) / max(float(np.quantile(image, 0.999)), 1e-9)
    side = 2 * max(round(_LEVELS_PX * scale), 1) + 1
    mean = cv2.blur(value, (side, side))
    variance = np.maximum(cv2.blur(value * value, (side, side)) - mean**2, 0) + _FLOOR
    slope_u, slope_v = (cv2.Scharr(value, cv2.CV_64F, *axes) / 32 for axes in ((1, 0), (0, 1)))
    noise = 2 * _NOISE_LEVELS**2 / variance + _MODEL
    return auxiliaries / 2 * (slope_u**2 + slope_v**2) / variance / noise


def _focal_baseline(rig: Rig) -> float:
    """Return focal length (px) times the auxiliaries' mean baseline (mm)."""
    baselines = [float(np.linalg.norm(rig.cam_from_core[name].center_mm)) for name in rig.auxiliaries]
    camera: Camera = rig.core_camera
    return float(camera.focal_px.mean()) * (float(np.mean(baselines)) if baselines else 300.0)


def _blocks(values: NDArray[np.floating], step: int) -> Map:
    """Return the mean (H / step, W / step) of whole blocks; NaN where a part of a block is."""
    height, width = (n // step for n in values.shape)
    cut = values[: height * step, : width * step].reshape(height, step, width, step)
    return cut.mean(axis=(1, 3), dtype=np.float64).astype(np.float32)


def _blurred(values: Map, sigma_px: float) -> NDArray[np.float64]:
    """Return (h, w) values blurred by a Gaussian; NaN where it reaches beyond them."""
    there = np.isfinite(values)
    inside = cv2.erode(there.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) > 0
    blurred = cv2.GaussianBlur(np.where(there, values, 0).astype(np.float64), (3, 3), sigma_px)
    return np.where(inside, blurred, np.nan)


def _planes(s: Map, slope_u: Map, slope_v: Map, step: int) -> NDArray[np.float64]:
    """Return inverse depth (h · step, w · step) in the blocks' px, every block a plane."""
    inside = (np.arange(step) - (step - 1) / 2) / step
    v, u = np.meshgrid(inside, inside, indexing="ij")
    whole = np.ones((step, step))
    return np.kron(s.astype(np.float64), whole) + np.kron(slope_u, u) + np.kron(slope_v, v)
