"""One frame as the multi-view matcher works on it: levels, splines and how each auxiliary sees the core's grid."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import FrameSet
from beltscape.core.rig import Rig
from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.defocus import match_defocus
from beltscape.stereo.multiview.frame.demosaicing import are_demosaiced
from beltscape.stereo.multiview.frame.inverse_depth import inverse_depth_scale, packed_projection
from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.photometry import compute_grey_levels, local_variance, noise_variance

_FLOOR = 2.7, 0.003
"""Texture is weak below so many noise variances, plus a share of the strongest texture's variance."""
_STRONG = 90.0
"""Percentile of the local variance that is the strongest texture's."""
_MODEL_VARIANCE = 0.05**2
"""What normalised levels of one point differ by without noise, until the residuals tell."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Variances of what is not texture."""

    levels: float
    """Of one image's levels, levels²."""
    model: float
    """Of normalised levels, without unit."""
    texture: float
    """Of the strongest texture, levels²: what noise is small against."""
    demosaiced: bool = False
    """Whether the images were interpolated from a colour filter array."""

    @property
    def floor(self) -> float:
        """Levels²: added to the variance of a window before it is divided by."""
        return _FLOOR[0] * self.levels + _FLOOR[1] * self.texture


@dataclass(frozen=True, slots=True, eq=False)
class PreparedFrame:
    """Levels of core and auxiliaries on the grid the matcher works on."""

    core: NDArray[np.float32]
    """(H, W) undistorted levels of the core; NaN where it did not look."""
    images: tuple[NDArray[np.float32], ...]
    """n of (h, w) levels of the auxiliaries as they were taken."""
    coefficients: tuple[NDArray[np.float32], ...]
    """n of (h, w), their cubic splines."""
    views: NDArray[np.float32]
    """(n, 21) how they see the core's grid: rows of native/view.hpp."""
    noise: Noise
    """What of the levels is not texture."""

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """(width, height) of the auxiliaries' images."""
        return [(image.shape[1], image.shape[0]) for image in self.images]


def prepare_frame(
    rig: Rig, frame_set: FrameSet, auxiliaries: tuple[str, ...], step: int, kernels: Kernels, threads: int
) -> PreparedFrame:
    """A frame for matching; ``step`` averages blocks of so many pixels, s counts pixels of that grid."""
    used = {name: frame_set.images[name] for name in (rig.core, *auxiliaries)}
    levels = compute_grey_levels(used, rig.core)
    raw, demosaiced = noise_variance(levels[rig.core]), are_demosaiced(levels.values())
    levels = match_defocus(rig.core, {name: downsample(level, step) for name, level in levels.items()})
    core = levels[rig.core]
    noise = Noise(raw / step**2, _MODEL_VARIANCE, _strongest_texture(core), demosaiced)
    unit = grid_unit(rig, auxiliaries, step)
    own = kernels.spline_coefficients(core, threads=threads)
    nowhere = np.zeros_like(core)
    straight, _ = kernels.warp(
        nowhere, packed_projection(rig, rig.core, unit, step, step), own, threads=threads
    )
    return PreparedFrame(
        core=np.asarray(straight, np.float32),
        images=tuple(levels[name] for name in auxiliaries),
        coefficients=tuple(
            np.asarray(kernels.spline_coefficients(levels[name], threads=threads), np.float32)
            for name in auxiliaries
        ),
        views=packed_projections(rig, auxiliaries, unit, step),
        noise=noise,
    )


def halve_frame(
    prepared: PreparedFrame, rig: Rig, auxiliaries: tuple[str, ...], step: int, kernels: Kernels, threads: int
) -> PreparedFrame:
    """A frame prepared in blocks of ``step``, in blocks of twice that."""
    core, *images = (downsample(level, 2) for level in (prepared.core, *prepared.images))
    looked = downsample(np.isfinite(prepared.core).astype(np.float32), 2)
    twice = 2 * step
    return PreparedFrame(
        core=np.where(looked < 1, np.float32(np.nan), core),
        images=tuple(images),
        coefficients=tuple(kernels.spline_coefficients(image, threads=threads) for image in images),
        views=packed_projections(rig, auxiliaries, grid_unit(rig, auxiliaries, twice), twice),
        noise=replace(
            prepared.noise,
            levels=prepared.noise.levels / 4,
            model=_MODEL_VARIANCE,
            texture=_strongest_texture(core),
        ),
    )


def _strongest_texture(core: NDArray[np.float32]) -> float:
    return float(np.percentile(local_variance(core)[::4, ::4], _STRONG))


def grid_unit(rig: Rig, auxiliaries: tuple[str, ...], step: int) -> float:
    """1/mm per step of s, where s counts pixels of the grid averaged in blocks of ``step``."""
    return inverse_depth_scale(rig, auxiliaries) * step


def packed_projections(rig: Rig, auxiliaries: tuple[str, ...], unit: float, step: int) -> NDArray[np.float32]:
    """(n, 21) how the auxiliaries, averaged in blocks, see the core's grid averaged alike."""
    return np.stack([packed_projection(rig, name, unit, step, step) for name in auxiliaries])


def crop_projection(view: NDArray[np.float32], first_u: int, first_v: int) -> NDArray[np.float32]:
    """(21,) the view of the grid whose pixel (0, 0) is (first_u, first_v) of the old one."""
    direction = view[:9].astype(np.float64).reshape(3, 3).copy()
    direction[:, 2] += first_u * direction[:, 0] + first_v * direction[:, 1]
    return np.concatenate([direction.ravel(), view[9:]]).astype(np.float32)


def subsample_projection(view: NDArray[np.float32], every: int) -> NDArray[np.float32]:
    """(21,) the view of the grid that has every so-manieth row and column, from the half of that on."""
    direction = view[:9].astype(np.float64).reshape(3, 3).copy()
    direction[:, 2] += every // 2 * (direction[:, 0] + direction[:, 1])
    direction[:, :2] *= every
    return np.concatenate([direction.ravel(), view[9:]]).astype(np.float32)


def downsample(level: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Levels averaged in whole blocks of ``step``; what did not look is black."""
    height, width = level.shape[0] // step, level.shape[1] // step
    cut = fill_nan(level[: height * step, : width * step])
    if step == 1:
        return cut
    return np.asarray(cv2.resize(cut, (width, height), interpolation=cv2.INTER_AREA), np.float32)
