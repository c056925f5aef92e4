"""A picture of a speckle pattern's quality: a detail, the nearest-neighbour distances and the power spectrum."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import STYLE, Form, make_panels, to_png
from beltscape.target.blue_noise import LOW_FREQUENCY, BlueNoise

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLUE, ORANGE = light("first"), light("second")
_SHEET = Form(1080.0, narrow=False)
"""The picture's width: three panels of a screen's width."""


def draw_quality(image: NDArray[np.uint8] | NDArray[np.uint16], quality: BlueNoise) -> bytes:
    """Return the PNG of the quality of a drawn pattern (H, W, 3); the same input gives the same bytes."""
    figure, (piece, nearest, spectrum) = make_panels(3, _SHEET, columns=3, height=275)
    with mpl.rc_context(dict(STYLE)):
        _show_piece(piece, image, quality.d_min_px)
        _plot_nearest(nearest, quality)
        _plot_spectrum(spectrum, quality)
    return to_png(figure)


def _show_piece(axes: Axes, image: NDArray[Any], d_min_px: float) -> None:
    """Show the surroundings of an inner marker, 40 d_min wide."""
    height, width = image.shape[:2]
    side = int(min(40 * d_min_px, width, height))
    left, top = (max(length * 3 // 8 - side // 2, 0) for length in (width, height))
    piece = image[top : top + side, left : left + side]
    shown = piece if piece.dtype == np.uint8 else (piece >> 8).astype(np.uint8)
    extent = (left - 0.5, left + side - 0.5, top + side - 0.5, top - 0.5)
    axes.imshow(shown, extent=extent, interpolation="nearest")
    axes.set_title("a piece of the pattern, px")


def _plot_nearest(axes: Axes, quality: BlueNoise) -> None:
    edges = quality.nearest_edges_px
    axes.stairs(quality.nearest_share, edges, fill=True, color=BLUE)
    axes.axvline(quality.d_min_px, color=ORANGE, linewidth=1)
    axes.set_xlim(edges[0] - (edges[-2] - edges[0]) / 10, edges[-2])
    axes.set_title(
        f"nearest neighbour: least {quality.nearest_min_px:.2f}, mean {quality.nearest_mean_px:.2f} px"
    )
    axes.set_xlabel(f"distance, px (line: d_min = {quality.d_min_px:g})")
    axes.set_ylabel("share of dots")


def _plot_spectrum(axes: Axes, quality: BlueNoise) -> None:
    frequency = quality.frequency_per_px
    axes.axvspan(0, LOW_FREQUENCY / quality.d_min_px, color=light("grid"), linewidth=0)
    axes.axhline(1, color=light("reference"), linewidth=0.8, linestyle="--")
    axes.plot(frequency, quality.power, color=BLUE)
    axes.set_xlim(0, frequency[-1])
    axes.set_ylim(bottom=0)
    axes.text(frequency[0], 1.02, "independent dots", va="bottom", color=light("reference"))
    axes.set_title(f"power spectrum: {quality.low_frequency_power:.3f} at low frequencies (shaded)")
    axes.set_xlabel("cycles per px")
