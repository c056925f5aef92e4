"""Picture of a coverage: what each camera needs of its image, and where the board was."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from beltscape.calibration.assessment.domain.coverage import CameraCoverage, Coverage
from beltscape.report.calibration_plots import frame_axes, make_image_panels
from beltscape.report.drawing.charts import Chart, Entry, Key
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import WIDE, Form, draw_dots, to_png
from beltscape.report.page import Section

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KEY = Key(
    (
        Entry("sees the volume", "band", "circle"),
        Entry("depth uncertain: the lens is extrapolated", "degraded", "circle"),
        Entry("depth unusable", "missing", "circle"),
        Entry("corners of the board", "quiet", "circle"),
        Entry("end of the lens's domain", "limit", "line"),
    )
)
STATES = ("band", "degraded", "missing")
"""Colours of needed pixels: certain or reached, uncertain, unusable."""
_DOT_PT, _CORNER_PT = 5.0, 1.5
"""Sizes of needed pixels and of corners: between the former, the latter are seen."""
_MOST_CORNERS = 250
"""Largest number of drawn corners of a camera; more would only make the page larger."""


def coverage_picture(coverage: Coverage) -> bytes:
    """Return the picture of a coverage as PNG."""
    figure = draw_coverage(coverage, WIDE)
    figure.suptitle(
        "blue: looks at the volume; orange: depth uncertain; red: depth unusable;\n"
        "grey dots: corners of the board; magenta: end of the lens's domain"
    )
    return to_png(figure)


def make_need_section(coverage: Coverage) -> Section:
    """Return the section that compares where the board was with what each camera needs of its image."""
    return Section(
        "Coverage of the measuring volume",
        f"The part of each image that sees {coverage.volume.name}, and where the board was. Where it never was, the "
        "lens is extrapolated: σ of a depth is computed there with more terms than the lens model has.",
        [
            Chart.draw(
                partial(draw_coverage, coverage), "Needed parts of the images, and the board's corners.", KEY
            )
        ],
    )


def draw_coverage(coverage: Coverage, form: Form) -> Figure:
    """Draw the needed pixels of every camera by their state, the board's corners and the lens's domain."""
    cameras = {name: each.camera for name, each in coverage.cameras.items()}
    figure, axes = make_image_panels(cameras, form)
    state = coverage.is_uncertain.astype(np.intp) + coverage.is_unusable
    for axis, (name, own) in zip(axes, coverage.cameras.items(), strict=True):
        shown = np.where(own.is_reached & ~own.is_beyond, 0, state)
        for k, role in enumerate(STATES):
            pixels = own.pixels[(shown == k) & np.isfinite(own.pixels[:, 0])]
            draw_dots(axis, np.unique(pixels.round(), axis=0), _DOT_PT, light(role))
        draw_dots(axis, _thin(own.corners_px), _CORNER_PT, light("quiet"))
        _draw_domain(axis, own)
        frame_axes(axis, own.camera, _make_title(name, coverage, own))
    return figure


def _draw_domain(axis: Axes, own: CameraCoverage) -> None:
    radius_px = own.camera.valid_radius_px
    if radius_px is not None:
        angle = np.linspace(0, 2 * np.pi, 181)
        circle = own.camera.center_px[:, None] + radius_px * np.stack([np.cos(angle), np.sin(angle)])
        axis.plot(*circle, color=light("limit"), linewidth=1.5)


def _make_title(name: str, coverage: Coverage, own: CameraCoverage) -> str:
    needed = np.isfinite(own.pixels[:, 0])
    gap = needed & coverage.is_uncertain & (own.is_beyond | ~own.is_reached)
    return f"{name}: {gap.sum() / max(int(needed.sum()), 1):.0%} uncertain"


def _thin(corners_px: NDArray[np.float64]) -> NDArray[np.float64]:
    return corners_px[:: -(-len(corners_px) // _MOST_CORNERS) or 1]
