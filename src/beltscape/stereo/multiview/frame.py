"""A frame prepared for matching, and the context that all stages share.

The frame holds grey levels, spline coefficients and projections on the matcher's grid; the context the rig, the
grid, the kernels and the window sizes, which grow with the images as the pattern's dots do.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.rig import Rig
from beltscape.kernels import FrameNumbers, Kernels
from beltscape.kernels.planes import average_blocks
from beltscape.kernels.statistics import find_percentile
from beltscape.stereo.multiview.photometry import compute_local_variance
from beltscape.stereo.multiview.surface import compute_inverse_depth_scale, fill_nan, pack_projections

Radii = tuple[tuple[int, float], ...]
"""Windows of a fit: (radius px, Gaussian sigma px), smallest first."""

_WIDTH_PX = 1224
"""Width of the grid to which the sizes below apply (scale 1)."""
_SCALE = (0.5, 1.8)
"""Range of the scale; MOST_PX limits the largest windows."""
_NARROW_PX, _FIRM_PX, _WIDE_PX = (1.5, 2.5), (4.0,), (2.5, 5.0)
"""Gaussian σ of the windows of least squares at scale 1: between rounds, twicing, last iteration."""
_RADIUS = 2.0
"""Radius of a window in sigmas of its Gaussian."""
_LEVELS_PX = 7
"""Radius of the window in which levels are normalised, at scale 1."""
MOST_PX = 15
"""Largest radius that the kernels accept."""
_BOXES_PX = (3, 5, 7, 9, 11, 15, 21, 25, 31)
"""Sides, at scale 1, of the square windows over which values are averaged or compared."""


@dataclass(frozen=True, slots=True)
class Windows:
    """Window sizes for one width of the grid."""

    narrow: Radii
    """Of the fits between rounds of propagation."""
    firm: Radii
    """Of twicing's fit."""
    wide: Radii
    """Of the last fit."""
    levels_px: int
    """Radius of the window in which levels are normalised."""
    boxes: Mapping[int, tuple[int, int]]
    """Odd (width, height) of square windows on the grid, by their side in px at scale 1."""
    scale: float
    """Factor of all distances in px; 1 on a grid as wide as half the paper's images."""


def choose_windows(width_px: int) -> Windows:
    """Return the window sizes for a grid of this width."""
    scale = float(np.clip(width_px / _WIDTH_PX, *_SCALE))
    narrow, firm, wide = (_choose_radii(sigmas_px, scale) for sigmas_px in (_NARROW_PX, _FIRM_PX, _WIDE_PX))
    return Windows(narrow, firm, wide, max(3, round(_LEVELS_PX * scale)), scale_boxes(scale), scale)


def scale_boxes(scale: float) -> dict[int, tuple[int, int]]:
    """Return the odd (width, height) of square windows on a grid of this scale, by their side in px at scale 1."""
    sides = {side_px: 2 * int(side_px * scale / 2) + 1 for side_px in _BOXES_PX}
    return {side_px: (side, side) for side_px, side in sides.items()}


def _choose_radii(sigmas_px: tuple[float, ...], scale: float) -> Radii:
    """Return radius and sigma of each window; radii are limited to what the kernels accept."""
    return tuple((min(MOST_PX, int(np.ceil(_RADIUS * sigma * scale))), sigma * scale) for sigma in sigmas_px)


@dataclass(frozen=True, slots=True, eq=False)
class MatchContext:
    """Rig, grid, kernels and window sizes that every stage uses on one grid."""

    rig: Rig
    auxiliaries: tuple[str, ...]
    """Names of the auxiliary cameras that are matched with the core."""
    step: int
    """Side of a grid pixel in image pixels."""
    kernels: Kernels
    threads: int
    """Number of threads; 0 takes one per processor core."""
    windows: Windows

    @classmethod
    def for_grid(
        cls, rig: Rig, auxiliaries: tuple[str, ...], step: int, kernels: Kernels, threads: int
    ) -> MatchContext:
        """Return the context of the grid whose pixels average blocks of ``step`` image pixels."""
        windows = choose_windows(rig.core_camera.size_px[0] // step)
        return cls(rig, auxiliaries, step, kernels, threads, windows)

    @property
    def scale(self) -> float:
        """Factor of all distances in px; 1 on a grid as wide as half the paper's images."""
        return self.windows.scale

    @property
    def inverse_depth_scale(self) -> float:
        """Unit of s on this grid, 1/mm."""
        return compute_inverse_depth_scale(self.rig, self.auxiliaries, self.step)

    def halve(self) -> MatchContext:
        """Return the context of the next coarser grid."""
        return self.for_grid(self.rig, self.auxiliaries, 2 * self.step, self.kernels, self.threads)


_FLOOR = 2.7, 0.003
"""Weight of the noise variance and of the strongest texture's variance in the floor of a window's variance."""
_STRONG = 90.0
"""Percentile of the local variance that counts as the strongest texture's."""
MODEL_VARIANCE = 0.05**2
"""First estimate of the variance by which normalised levels of one point differ without noise."""


@dataclass(frozen=True, slots=True)
class Noise(FrameNumbers):
    """Variances of everything in the levels that is not texture."""

    levels: float
    """Of the levels of one image, levels²."""
    model: float
    """Of normalised levels, from sampling, gloss and other model errors; without unit."""
    texture: float
    """Of the strongest texture, levels²."""
    demosaiced: bool = False
    """Whether the images were interpolated from a colour filter array."""

    floor: float = field(init=False)
    """Variance, levels², that is added to the variance of a window before division."""

    def __post_init__(self) -> None:
        """Compute the floor."""
        object.__setattr__(self, "floor", _FLOOR[0] * self.levels + _FLOOR[1] * self.texture)


@dataclass(frozen=True, slots=True, eq=False)
class PreparedFrame:
    """Grey levels of the core and the auxiliaries on the matcher's grid."""

    core: NDArray[np.float32]
    """(H, W) undistorted levels of the core; NaN outside its image."""
    filled_core: NDArray[np.float32] = field(init=False)
    """(H, W) levels of the core with 0 outside its image."""
    images: tuple[NDArray[np.float32], ...]
    """n of (h, w) levels of the auxiliaries, distorted as taken."""
    coefficients: tuple[NDArray[np.float32], ...]
    """n of (h, w) coefficients of the cubic splines through ``images``."""
    views: NDArray[np.float32]
    """(n, 39) packed projections of the core's grid into the auxiliaries (native/view.hpp)."""
    noise: Noise
    context: MatchContext

    def __post_init__(self) -> None:
        """Fill the core."""
        object.__setattr__(self, "filled_core", fill_nan(self.core))

    def with_noise(self, noise: Noise) -> PreparedFrame:
        """Return the same frame with another noise."""
        changed = copy(self)
        object.__setattr__(changed, "noise", noise)
        return changed

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """(width, height) of the auxiliaries' images."""
        return [(image.shape[1], image.shape[0]) for image in self.images]


def halve_frame(prepared: PreparedFrame) -> PreparedFrame:
    """Return the frame on a grid of half the width and height."""
    context = prepared.context.halve()
    core, *images = (downsample(level, 2) for level in (prepared.filled_core, *prepared.images))
    valid_share = downsample(np.isfinite(prepared.core).astype(np.float32), 2)
    noise = replace(
        prepared.noise,
        levels=prepared.noise.levels / 4,
        model=MODEL_VARIANCE,
        texture=find_strongest_texture(core),
    )
    return PreparedFrame(
        core=np.where(valid_share < 1, np.float32(np.nan), core),
        images=(on_grid := tuple(map(context.kernels.keep, images))),
        coefficients=tuple(
            context.kernels.spline_coefficients(image, threads=context.threads) for image in on_grid
        ),
        views=pack_projections(context.rig, context.auxiliaries, context.inverse_depth_scale, context.step),
        noise=noise,
        context=context,
    )


def find_strongest_texture(core: NDArray[np.float32]) -> Any:
    """Return the strongest texture's variance, levels²: a number, on a GPU where the core is."""
    return find_percentile(compute_local_variance(core, 4), _STRONG)


def downsample(level: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Return the levels, which have no NaN, averaged over whole blocks of ``step`` pixels."""
    return level if step == 1 else average_blocks(level, step)
