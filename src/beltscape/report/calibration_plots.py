"""Charts of a calibration's report, and the picture of its coverage.

The coverage shows what each camera needs of its image, and where the board was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from beltscape.calibration.assessment.covariance import DepthSigma
from beltscape.calibration.assessment.coverage import CameraCoverage, Coverage
from beltscape.calibration.assessment.score import RigErrors
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig
from beltscape.report.drawing.charts import Chart, ChartKey, KeyEntry
from beltscape.report.drawing.legend import DARK_IS_CERTAIN, UNCERTAINTY, Scale
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import (
    FONT_PT,
    WIDE,
    Form,
    compute_map_height,
    draw_dots,
    draw_lines,
    fade_unmeasured,
    make_panels,
    show_map,
    to_png,
)
from beltscape.report.page import Section

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_COLORS = 12
"""Colour steps of the corners' errors: finer ones are not visible in dots of this size."""
_MOST_ARROWS = 400
"""Largest number of drawn residuals of a camera; more would cover one another."""


def depth_sigma_chart(maps: Sequence[DepthSigma], caption: str) -> Chart:
    """Return σ of depth over the core camera's view, at each distance, on one scale."""
    top = max(float(np.nanquantile(m.sigma_mm, 0.98)) for m in maps)
    scale = Scale(0.0, top, UNCERTAINTY, label=f"σ of depth, mm; {DARK_IS_CERTAIN}")
    return Chart.draw(partial(_depth_sigma, maps, scale), caption, scale)


def _depth_sigma(maps: Sequence[DepthSigma], scale: Scale, form: Form) -> Figure:
    widest = max(maps, key=lambda m: np.ptp(m.y_mm) / np.ptp(m.x_mm))
    height = compute_map_height(form, float(np.ptp(widest.x_mm)), float(np.ptp(widest.y_mm)), columns=3)
    figure, axes = make_panels(len(maps), form, columns=3, height=height + 14)
    for axis, m in zip(axes, maps, strict=True):
        extent = (m.x_mm[0], m.x_mm[-1], m.y_mm[-1], m.y_mm[0])
        show_map(
            axis,
            fade_unmeasured(scale.to_rgb(m.sigma_mm), m.sigma_mm, np.ones(m.sigma_mm.shape)),
            extent,
            first_row_below=False,
        )
        title = f"{m.depth_mm:.0f} mm: median {np.nanmedian(m.sigma_mm):.3f} mm"
        axis.set(title=title, xlabel="x, mm", ylabel="y, mm")
    return figure


def coverage_chart(rig: Rig, rig_errors: RigErrors, caption: str) -> Chart:
    """Return the corners in each camera's image, coloured by their reprojection error."""
    top = float(np.quantile(np.linalg.norm(rig_errors.compute_errors_px(), axis=1), 0.98))
    scale = Scale(0.0, top, UNCERTAINTY, label=f"reprojection error, px; {DARK_IS_CERTAIN}")
    return Chart.draw(partial(_coverage, rig, rig_errors, scale), caption, scale)


def _coverage(rig: Rig, rig_errors: RigErrors, scale: Scale, form: Form) -> Figure:
    figure, axes = make_image_panels(rig.cameras, form)
    for axis, (name, camera) in zip(axes, rig.cameras.items(), strict=True):
        pixels, errors = _residuals(rig_errors, name)
        size = np.linalg.norm(errors, axis=1)
        step = np.clip(size / scale.high * _COLORS, 0, _COLORS - 1).astype(int)
        for k in np.unique(step):
            color = tuple(scale.to_rgb(np.array((k + 0.5) / _COLORS * scale.high)) / 255.0)
            draw_dots(axis, pixels[step == k], 2.4, color)
        frame_axes(axis, camera, f"{name}: {len(pixels)} corners")
    return figure


def residual_chart(rig: Rig, rig_errors: RigErrors) -> Chart:
    """Return residual arrows in each camera's image, and the caption with their magnification."""
    median = float(np.median(np.linalg.norm(rig_errors.compute_errors_px(), axis=1)))
    magnify = 0.02 * max(max(c.size_px) for c in rig.cameras.values()) / max(median, 1e-6)
    most = max(len(_residuals(rig_errors, name)[0]) for name in rig.cameras)
    every = -(-most // _MOST_ARROWS)
    which = "" if every == 1 else f" One corner of {every} is drawn."
    caption = f"Residuals, magnified {magnify:.0f} times.{which}"
    return Chart.draw(partial(_residual_arrows, rig, rig_errors, magnify, every), caption)


def _residual_arrows(rig: Rig, rig_errors: RigErrors, magnify: float, every: int, form: Form) -> Figure:
    figure, axes = make_image_panels(rig.cameras, form)
    for axis, (name, camera) in zip(axes, rig.cameras.items(), strict=True):
        pixels, errors = _residuals(rig_errors, name)
        start, arrow = pixels[::every], magnify * errors[::every]
        left, right = (arrow @ np.array([[-0.3, 0.16 * side], [-0.16 * side, -0.3]]) for side in (1, -1))
        tip = start + arrow
        draw_lines(
            axis, np.stack([start, tip, tip + left, tip, tip + right], axis=1),
            color=light("first"), linewidth=0.9,
        )  # fmt: skip
        rms = float(np.sqrt((errors**2).sum(axis=1).mean())) if len(errors) else float("nan")
        frame_axes(axis, camera, f"{name}: RMS {rms:.3f} px")
    return figure


def _residuals(rig_errors: RigErrors, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the positions (n, 2) of a camera's corners and their residuals (n, 2), px."""
    views = rig_errors.residuals[name].values()
    none = np.empty((0, 2))
    return (
        np.concatenate([none, *(v.pixels for v in views)]),
        np.concatenate([none, *(v.errors_px for v in views)]),
    )


def make_image_panels(cameras: Mapping[str, Camera], form: Form) -> tuple[Figure, list[Axes]]:
    """Return a figure with one panel for the image of each camera."""
    tallest = max(cameras.values(), key=lambda camera: camera.size_px[1] / camera.size_px[0])
    height = compute_map_height(form, *tallest.size_px, columns=3)
    return make_panels(len(cameras), form, columns=3, height=height)


def frame_axes(axis: Axes, camera: Camera, title: str) -> None:
    """Give a panel the limits and the frame of a camera's image."""
    width, height = camera.size_px
    axis.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", title=title)
    axis.spines[["top", "right"]].set_visible(True)
    axis.spines[:].set_edgecolor(light("quiet"))
    axis.set_xticks([0, width - 1])
    axis.set_yticks([0, height - 1])


KEY = ChartKey(
    (
        KeyEntry("the board was here", "shared", "circle"),
        KeyEntry("it was not, and the lens is certain", "band", "circle"),
        KeyEntry("depth uncertain: the lens is extrapolated", "degraded", "circle"),
        KeyEntry("depth unusable", "missing", "circle"),
        KeyEntry("corners of the board", "quiet", "circle"),
        KeyEntry("end of the lens's domain", "limit", "line"),
    )
)
STATES = ("shared", "band", "degraded", "missing")
"""Colours of needed pixels: reached by the board, certain without it, uncertain, unusable."""
_DOT_PT, _CORNER_PT = 6.5, 1.5
"""Sizes of needed pixels and of corners: between the former, the latter are seen."""
_MOST_CORNERS = 250
"""Largest number of drawn corners of a camera; more would only make the page larger."""
_MOST_CAMERAS = 12
"""Largest number of cameras in the picture, which must fit a screen; the report has all."""
_LINE = 128
"""Characters to a line of the picture's heading."""
_LINE_PT = 1.3 * FONT_PT
"""Height of such a line."""


def coverage_picture(coverage: Coverage, heading: str = "") -> bytes:
    """Return the picture of a coverage as PNG, with a heading above the key; of many cameras those with most gaps."""
    gaps = {name: _count_gap(coverage, own) for name, own in coverage.cameras.items()}
    kept = sorted(gaps, key=lambda name: -gaps[name])[:_MOST_CAMERAS]
    shown = {name: own for name, own in coverage.cameras.items() if name in kept}
    figure = draw_coverage(replace(coverage, cameras=shown), WIDE)
    key = (
        f"Dots: pixels that see {coverage.volume.name}. Green: the board was here; blue: it was not, and the lens is "
        "certain; orange: depth uncertain, the lens is extrapolated; red: depth unusable. Grey: corners of the "
        f"board; magenta: end of the lens's domain.{_describe_omitted(len(gaps) - len(shown))}"
    )
    lines = [*wrap(heading, _LINE), *wrap(key, _LINE)]
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + len(lines) * _LINE_PT / 72)
    figure.suptitle("\n".join(lines), x=0.01, ha="left", fontsize=FONT_PT)
    return to_png(figure)


def _describe_omitted(count: int) -> str:
    return f" {count} cameras with smaller gaps are not shown." if count else ""


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
    state = 1 + coverage.is_uncertain.astype(np.intp) + coverage.is_unusable
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
    count = max(int(needed.sum()), 1)
    reached = (needed & own.is_reached & ~own.is_beyond).sum()
    return f"{name}: board at {reached / count:.0%}, {_count_gap(coverage, own) / count:.0%} uncertain"


def _count_gap(coverage: Coverage, own: CameraCoverage) -> int:
    """Return the number of needed pixels that the board never reached and whose depth is uncertain."""
    gap = np.isfinite(own.pixels[:, 0]) & coverage.is_uncertain & (own.is_beyond | ~own.is_reached)
    return int(gap.sum())


def _thin(corners_px: NDArray[np.float64]) -> NDArray[np.float64]:
    return corners_px[:: -(-len(corners_px) // _MOST_CORNERS) or 1]
