"""Depth and uncertainty as colours, with a scale that one can read."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.frames import Image, grey

Rgb = NDArray[np.uint8]

GROUND = np.array([38, 42, 48], np.uint8)
"""What is not measured."""
_INK = (235, 238, 241)
_PANEL_PX = 760


def colored(values: NDArray[np.floating], low: float, high: float, colormap: int = cv2.COLORMAP_TURBO) -> Rgb:
    """(H, W) values → (H, W, 3) RGB between ``low`` and ``high``; NaN dark grey."""
    scaled = np.clip((values - low) / max(high - low, 1e-9), 0, 1)
    eight = np.rint(255 * np.nan_to_num(scaled)).astype(np.uint8)
    image = np.asarray(cv2.applyColorMap(eight, colormap)[..., ::-1], np.uint8).copy()
    image[~np.isfinite(values)] = GROUND
    return image


def colored_difference(values: NDArray[np.floating], limit: float) -> Rgb:
    """(H, W) values → (H, W, 3) RGB: blue below 0, white at 0, red above, full at ±``limit``; NaN dark grey."""
    share = np.clip(np.nan_to_num(values) / limit, -1, 1)[..., None]
    low, high = np.array([23.0, 78.0, 166.0]), np.array([178.0, 24.0, 43.0])
    end = np.where(share < 0, low, high)
    image = np.rint(250 + np.abs(share) * (end - 250)).astype(np.uint8)
    image[~np.isfinite(values)] = GROUND
    return image


def span(values: NDArray[np.floating], share: float = 0.005) -> tuple[float, float]:
    """Range of the finite values without the outermost ``share`` on both sides; (0, 1) where there are none."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    low, high = np.quantile(finite, [share, 1 - share])
    return float(low), float(max(high, low + 1e-6))


def panel(
    image: Rgb,
    title: str,
    scale: tuple[float, float, str] | None = None,
    colormap: int | None = cv2.COLORMAP_TURBO,
) -> Rgb:
    """One picture with its title and, where given, a colour scale (low, high, unit) below; None: differences."""
    factor = _PANEL_PX / image.shape[1]
    interpolation = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    body = cv2.resize(image, (_PANEL_PX, round(image.shape[0] * factor)), interpolation=interpolation)
    head = np.full((34, _PANEL_PX, 3), GROUND, np.uint8)
    foot = np.full((44, _PANEL_PX, 3), GROUND, np.uint8)
    _write(head, title, (10, 23))
    if scale is not None:
        low, high, unit = scale
        steps = np.linspace(0, 1, _PANEL_PX - 20)[None].repeat(10, axis=0)
        ramp = colored_difference(2 * steps - 1, 1) if colormap is None else colored(steps, 0, 1, colormap)
        foot[6:16, 10:-10] = ramp
        for position in (0.0, 0.5, 1.0):
            text = f"{low + position * (high - low):.4g} {unit}"
            width = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1)[0][0]
            _write(foot, text, (int(10 + position * (_PANEL_PX - 20 - width)), 34), 0.45)
    return np.concatenate([head, np.asarray(body, np.uint8), foot])


def beside(panels: list[Rgb]) -> Rgb:
    """Panels of one height side by side."""
    height = max(p.shape[0] for p in panels)
    padded = [np.pad(p, ((0, height - p.shape[0]), (0, 0), (0, 0))) for p in panels]
    return np.ascontiguousarray(np.concatenate(padded, axis=1))


def to_rgb(image: Image) -> Rgb:
    """An image stretched to 8 bit RGB, dark scenes brightened so that one sees the pattern."""
    top = max(float(np.quantile(grey(image), 0.995)), 1.0)
    bright = np.clip(image.astype(np.float32) / top, 0, 1) ** 0.6
    eight = np.rint(255 * bright).astype(np.uint8)
    return eight if eight.ndim == 3 else np.repeat(eight[..., None], 3, axis=2)


def thumbnail(image: Image, width_px: int = 480) -> Rgb:
    """An image small enough for a page, brightened so that one sees what is on it."""
    factor = min(1.0, width_px / image.shape[1])
    return np.asarray(
        cv2.resize(to_rgb(image), None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA), np.uint8
    )


def preview(depth: DepthMap, core_image: Image) -> Rgb:
    """preview.png: what the core camera saw, its depth and the depth's standard deviation."""
    return beside(list(preview_panels(depth, core_image)))


def preview_panels(depth: DepthMap, core_image: Image) -> tuple[Rgb, Rgb, Rgb]:
    """The three pictures of a preview: core image (undistorted), depth, σ."""
    near, far = span(depth.depth_mm)
    sigma_top = span(depth.sigma_mm, 0.02)[1]
    return (
        panel(to_rgb(core_image), "core camera, undistorted"),
        panel(
            colored(-depth.depth_mm, -far, -near), f"depth: {depth.coverage:.1%} measured", (far, near, "mm")
        ),
        panel(
            colored(depth.sigma_mm, 0, sigma_top, cv2.COLORMAP_VIRIDIS),
            "one standard deviation of the depth",
            (0, sigma_top, "mm"),
            cv2.COLORMAP_VIRIDIS,
        ),
    )


def _write(image: Rgb, text: str, where: tuple[int, int], size: float = 0.55) -> None:
    cv2.putText(image, text, where, cv2.FONT_HERSHEY_SIMPLEX, size, _INK, 1, cv2.LINE_AA)
