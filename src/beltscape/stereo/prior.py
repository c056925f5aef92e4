"""The surface of the frame before, moved with the belt: where it still fits, no sweep is needed."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.rig import Rig
from beltscape.kernels import Kernels
from beltscape.stereo.nearness import displaced_row
from beltscape.stereo.prepared import PreparedFrame
from beltscape.stereo.windows import windows

_FIT_VARIANCE = 0.05
"""Of normalised levels: a surface that is off by half a pixel still fits."""

_LONE_PX = 48
_MISSING = 0.5
"""A place is missing when that share of the pixels about it is; smaller gaps are left to their neighbours."""
_AROUND_PX = 32


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What was seen in the frame before, and how far it has moved since."""

    depth: DepthMap
    """Of the frame before, from the same rig."""
    motion_mm: NDArray[np.float64]
    """(3,) displacement of the material since then, in the core camera's frame."""


def moved_nearness(
    prior: Prior, rig: Rig, prepared: PreparedFrame, unit: float, step: int, kernels: Kernels, threads: int
) -> NDArray[np.float32]:
    """(H, W) nearness s on the prepared grid where the moved surface, by and large, fits the images; NaN elsewhere.

    A surface that moves by t before a still camera is seen as a still one from a camera at -t: the moved
    nearness is the nearness buffer of that camera, with the core's own pinhole.
    """
    height, width = prepared.core.shape
    depth = prior.depth.depth_mm[step // 2 : height * step : step, step // 2 : width * step : step]
    with np.errstate(divide="ignore", invalid="ignore"):
        before = (1 / (depth * unit)).astype(np.float32)
    view = displaced_row(rig, prior.motion_mm * unit, step)
    (buffer,) = kernels.nearness_buffers(before, view[None], [(width, height)], threads=threads)
    s = np.where(buffer > 0, buffer, np.nan).astype(np.float32)
    found = kernels.normal_equations(
        s, prepared.core, prepared.coefficients, prepared.views, window=windows(width).levels_px,
        floor=prepared.noise.floor, noise_variance=prepared.noise.levels, model_variance=_FIT_VARIANCE,
        threads=threads,
    )  # fmt: skip
    agreed = found.used >= min(2, len(prepared.images))
    fits = np.where(agreed, s, np.nan).astype(np.float32)
    return np.where(_share(agreed) > 1 - _MISSING, s, fits)


def missing_block(s: NDArray[np.float32], shrink: int) -> tuple[slice, slice]:
    """Rows and columns about the pixels without a surface, beginning at multiples of ``shrink``.

    Lone pixels do not count: the sweep's neighbours about them are all there is to fill them with. The block is
    wider than what is missing, so that the aggregation's paths come from somewhere, and never empty.
    """
    missing = _share(~np.isfinite(s)) > _MISSING
    rows, columns = np.flatnonzero(missing.any(axis=1)), np.flatnonzero(missing.any(axis=0))
    return _span(rows, s.shape[0], shrink), _span(columns, s.shape[1], shrink)


def _share(of: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W) of the pixels about each; the image's edge goes on as it is, so that strips along it count."""
    window = (_LONE_PX, _LONE_PX)
    return np.asarray(cv2.blur(of.astype(np.float32), window, borderType=cv2.BORDER_REPLICATE), np.float32)


def _span(where: NDArray[np.intp], size: int, shrink: int) -> slice:
    first, last = (int(where[0]), int(where[-1]) + 1) if where.size else (0, 0)
    first = max(0, first - _AROUND_PX) // shrink * shrink
    return slice(first, min(size, max(last + _AROUND_PX, first + 8 * shrink)))
