"""Pictures of a depth map: depth, σ, number of views, confidence, and the error against the truth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.report.drawing.legend import (
    CERTAINTY,
    DARK_IS_CERTAIN,
    DIFFERENCE,
    NEAR_TO_FAR,
    QUIET,
    UNCERTAINTY,
    Color,
    Rgb,
    Scale,
    Swatches,
    round_above,
    round_below,
)
from beltscape.report.drawing.pictures import PANEL_PX, Panel, arrange_panels, quantile_range

NO_TRUTH: Color = (0, 0, 0)
"""Colour of pixels without a true depth; no colour map contains black."""
_UNMEASURED = ("not measured", QUIET)
GAPS = Swatches([_UNMEASURED])
NO_ERROR = Swatches([_UNMEASURED, ("no truth", NO_TRUTH)])
"""Keys of the colours for missing values."""
LIGHT = np.array([-1.0, -1.0, -2.0]) / np.sqrt(6.0)
"""Unit vector from the surface to the light, which is above left, in camera axes."""
_STEEPEST = 3.0
"""Largest slope for shading: steps of the depth are not shaded darker."""
_SHADES = (0.35, 1.25)
"""Darkest and brightest shade, within which the colours of the height stay recognisable."""
_FLAT_MM = 1.0
"""Smallest depth range of the colour scale, so that the noise of a flat surface does not fill it."""
_ERROR_MEDIANS = 6.0
"""Limit of the scale of errors over their median size: four σ of normal errors."""
_RELIABILITY_SIGMAS = 4.0
"""Range of the error picture in units of σ."""


def draw_depth_map(depth: DepthMap, true_depth_mm: NDArray[np.floating] | None = None) -> Rgb:
    """Draw depth, σ, views and confidence, (H', W', 3) RGB; with the truth also the error in mm and in σ.

    Raises
    ------
    InputError
        When the truth (H, W, mm, NaN = unknown) is not on the depth map's grid.
    """
    four = [
        make_depth_panel(depth),
        make_sigma_panel(depth),
        make_views_panel(depth),
        make_confidence_panel(depth),
    ]
    if true_depth_mm is None:
        return arrange_panels(four, 2)
    errors = [make_error_panel(depth, true_depth_mm), make_reliability_panel(depth, true_depth_mm)]
    return arrange_panels([*four[:2], errors[0], *four[2:], errors[1]], 3)


def make_depth_panel(depth: DepthMap) -> Panel:
    """Return the depth, near bright, shaded by light from above left."""
    z = _subsample(depth.depth_mm)
    near, far = quantile_range(z)
    scale = Scale(near, max(far, near + _FLAT_MM), NEAR_TO_FAR)
    return Panel(shade_depth(z, scale), "depth, mm", scale, key=GAPS, note=f"{depth.coverage:.1%} measured")


def make_sigma_panel(depth: DepthMap) -> Panel:
    """Return one standard deviation of the depth on a logarithmic scale between round ends."""
    sigma = _subsample(depth.sigma_mm)
    positive = sigma[sigma > 0]
    low, high = quantile_range(positive, 0.01) if positive.size else (0.1, 1.0)
    low, high = round_below(low), round_above(high)
    scale = Scale(low, high if high > low else 10 * low, UNCERTAINTY, log=True, label=DARK_IS_CERTAIN)
    note = f"median {np.median(positive):.2g}" if positive.size else ""
    return Panel(scale.to_rgb(sigma), "one standard deviation of the depth, mm", scale, key=GAPS, note=note)


def make_views_panel(depth: DepthMap) -> Panel:
    """Return the number of auxiliaries that measured each pixel, one colour per number."""
    most = max(int(depth.views.max(initial=0)), 1)
    steps = np.rint(np.linspace(0, 255, most)) if most > 1 else np.array([255])
    colors = np.vstack([QUIET, CERTAINTY[steps.astype(int)]]).astype(np.uint8)
    entries = [(str(n), _color(colors[n])) for n in range(1, most + 1)]
    image = colors.take(_subsample(depth.views), axis=0)
    return Panel(image, "views used", Swatches([*entries, _UNMEASURED]))


def make_confidence_panel(depth: DepthMap) -> Panel:
    """Return the confidence that a pixel is no false surface; grey: not measured."""
    confidence = np.where(np.isfinite(depth.depth_mm), depth.confidence, np.float32(np.nan))
    scale = Scale(0.0, 1.0, CERTAINTY, label=DARK_IS_CERTAIN)
    mean = float(depth.confidence[depth.measured].mean()) if depth.measured.any() else 0.0
    note = f"mean {mean:.2f}"
    return Panel(
        scale.to_rgb(_subsample(confidence)),
        "confidence that it is no false surface",
        scale,
        key=GAPS,
        note=note,
    )


def make_error_panel(
    depth: DepthMap, true_depth_mm: NDArray[np.floating], *, limit_mm: float | None = None
) -> Panel:
    """Return measured minus true depth: blue nearer, red farther, grey not measured, black without truth.

    Parameters
    ----------
    depth
        The measured depth map.
    true_depth_mm
        (H, W) true depth on the same grid, mm; NaN = unknown.
    limit_mm
        Error at the ends of the colour scale; by default a round value above six times the median.

    Raises
    ------
    InputError
        When the shapes differ.
    """
    error = _error_mm(depth, true_depth_mm)
    size = np.abs(error[np.isfinite(error)])
    limit = limit_mm or round_above(max(_ERROR_MEDIANS * float(np.median(size)), 1e-3) if size.size else 1.0)
    note = f"median size {np.median(size):.2g}" if size.size else ""
    return _make_error_panel(error, true_depth_mm, limit, "measured minus true depth, mm", note)


def make_reliability_panel(depth: DepthMap, true_depth_mm: NDArray[np.floating]) -> Panel:
    """Return the error in units of its σ: pale where σ is reliable or too large."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = _error_mm(depth, true_depth_mm) / depth.sigma_mm
    size = np.abs(ratio[np.isfinite(ratio)])
    note = f"{(size <= 1).mean():.0%} within one σ, honest is 68%" if size.size else ""
    return _make_error_panel(ratio, true_depth_mm, _RELIABILITY_SIGMAS, "measured minus true depth, σ", note)


def _error_mm(depth: DepthMap, true_depth_mm: NDArray[np.floating]) -> NDArray[np.float32]:
    if true_depth_mm.shape != depth.depth_mm.shape:
        raise InputError(f"the truth is {true_depth_mm.shape}, the depth map {depth.depth_mm.shape} pixels")
    return (depth.depth_mm - true_depth_mm).astype(np.float32)


def _make_error_panel(
    values: NDArray[np.float32], true_depth_mm: NDArray[np.floating], limit: float, title: str, note: str
) -> Panel:
    scale = Scale(-limit, limit, DIFFERENCE)
    image = color_errors(_subsample(values), _subsample(true_depth_mm), scale)
    return Panel(image, title, scale, key=NO_ERROR, note=note)


def shade_depth(depth_mm: NDArray[np.float32], scale: Scale) -> Rgb:
    """Return the colours (H, W, 3) of a depth (H, W), shaded as a matt surface lit from above left."""
    return _shade(scale.to_rgb(depth_mm), depth_mm)


def color_errors(values: NDArray[np.floating], true_depth_mm: NDArray[np.floating], scale: Scale) -> Rgb:
    """Return the colours (H, W, 3) of errors (H, W); black without truth."""
    image = scale.to_rgb(np.asarray(values, np.float32))
    image[~np.isfinite(true_depth_mm)] = NO_TRUTH
    return image


def _subsample(values: NDArray[Any]) -> NDArray[Any]:
    """Return every n-th pixel, at the panel's width or up to twice that."""
    step = max(values.shape[1] // PANEL_PX, 1)
    return values[::step, ::step]


def _shade(image: Rgb, depth_mm: NDArray[np.float32]) -> Rgb:
    """Shade colours as a matt surface; slopes assume a horizontal field of view of 53°."""
    footprint = depth_mm / depth_mm.shape[1]
    p, q = np.zeros_like(depth_mm), np.zeros_like(depth_mm)
    p[:, :-1], q[:-1] = np.diff(depth_mm, axis=1), np.diff(depth_mm, axis=0)
    p, q = (np.nan_to_num(np.clip(slope / footprint, -_STEEPEST, _STEEPEST)) for slope in (p, q))
    lit = (LIGHT[0] * p + LIGHT[1] * q - LIGHT[2]) / np.sqrt(1 + p * p + q * q) / -LIGHT[2]
    shade = np.clip(lit, *_SHADES).astype(np.float32)
    return np.clip(image * shade[..., None], 0, 255).astype(np.uint8)


def _color(values: NDArray[np.uint8]) -> Color:
    red, green, blue = (int(v) for v in values)
    return red, green, blue
