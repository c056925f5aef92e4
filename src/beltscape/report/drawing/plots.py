"""Matplotlib plots in a common style, as SVG for pages and PNG for files, without a window system."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from io import BytesIO, StringIO
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray

from beltscape.report.drawing.fallback_text import FallbackCanvas, tolerate_missing_glyphs
from beltscape.report.drawing.palette import css_color, light
from beltscape.report.drawing.panel_layout import PanelLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from beltscape.report.drawing.legend import Rgb

FONT_PT = 11.0
"""Size of all text; a form's unit is at least one CSS pixel (page.css), and 11 px are legible."""


@dataclass(frozen=True, slots=True)
class Form:
    """The layout width of a chart."""

    width: float
    """Points."""
    narrow: bool


WIDE, NARROW = Form(800.0, narrow=False), Form(300.0, narrow=True)
"""For screens from 900 px and paper, and for phones."""

_TALLEST = 420.0
"""Largest height of a map, points, so that it fits on a screen."""
_FADED_ALPHA = 90
"""Opacity (of 255) of cells that were not measured; their colours stay recognisable."""

_DOT_LENGTH = 1e-6
"""Length of a dot over the points' extent: far below a pixel, far above the 1e-14 below which Agg draws nothing."""

STYLE: Mapping[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": FONT_PT,
    "text.color": light("ink"),
    "text.parse_math": False,
    "axes.titlesize": FONT_PT,
    "axes.labelcolor": light("ink"),
    "axes.edgecolor": light("quiet"),
    "axes.facecolor": "none",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": light("grid"),
    "xtick.color": light("quiet"),
    "ytick.color": light("quiet"),
    "figure.facecolor": "none",
    "figure.dpi": 144,
    "svg.fonttype": "none",
    "svg.hashsalt": "beltscape",
    "image.composite_image": False,
    "path.simplify": False,
}
"""Matplotlib's settings for all charts: thin grey axes without a frame, so that the data stand out."""


def make_panels(
    count: int, form: Form, *, columns: int = 1, height: float = 200.0, narrow_height: float | None = None
) -> tuple[Figure, list[Axes]]:
    """Return a figure with ``count`` axes in rows of ``columns``, below one another where it is narrow.

    The heights of one panel are in points.
    """
    columns = 1 if form.narrow else min(columns, count)
    rows = -(-count // columns)
    each = narrow_height if form.narrow and narrow_height is not None else height
    with mpl.rc_context(dict(STYLE)):
        figure = Figure(figsize=(form.width / 72, each * rows / 72), layout=PanelLayout())
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for unused in axes[count:]:
        unused.set_visible(False)
    return figure, list(axes[:count])


def show_map(axis: Axes, colors: Rgb, extent: Sequence[float], *, first_row_below: bool = True) -> None:
    """Draw an (H, W, 3 or 4) image of colours, cell by cell; ``extent`` is left, right, bottom and top."""
    origin = "lower" if first_row_below else "upper"
    axis.imshow(colors, origin=origin, extent=tuple(extent), interpolation="none", aspect="equal")


def fade_unmeasured(
    colors: Rgb, values: NDArray[np.floating], share: NDArray[np.floating] | NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Return a map's colours, (H, W, 4), faded by the unmeasured share of a cell, transparent without a value.

    ``share`` (H, W) is the measured share of each cell, 0 to 1.
    """
    alpha = np.where(np.isfinite(values), _FADED_ALPHA + (255 - _FADED_ALPHA) * np.clip(share, 0, 1), 0)
    return np.dstack([colors, np.rint(alpha).astype(np.uint8)])


def compute_map_height(
    form: Form, width: float, height: float, *, columns: int = 1, least: float = 90.0
) -> float:
    """Return the height in points of a panel that shows ``width`` × ``height`` to scale, with its labels."""
    across = form.width / (1 if form.narrow else columns) - 62
    return min(max(across * height / max(width, 1e-9), least), _TALLEST) + 58


def draw_lines(axis: Axes, lines: NDArray[np.float64], **style: Any) -> None:
    """Draw polylines (n, k, 2) as one path, which keeps the page small."""
    parted = np.concatenate([lines, np.full((len(lines), 1, 2), np.nan)], axis=1).reshape(-1, 2)
    axis.plot(*parted.T, solid_capstyle="round", solid_joinstyle="round", **style)


def draw_dots(axis: Axes, points: NDArray[np.float64], size_pt: float, color: Any) -> None:
    """Draw dots at points (n, 2) as one path of very short lines; a PNG leaves out those without length."""
    length = _DOT_LENGTH * max(float(np.ptp(points, axis=0).max()), 1.0) if len(points) else 0.0
    draw_lines(axis, np.stack([points, points + length], axis=1), color=color, linewidth=size_pt, snap=False)


def to_png(figure: Figure) -> bytes:
    """Return the figure as PNG on white; the same figure gives the same bytes."""
    with mpl.rc_context(dict(STYLE)), tolerate_missing_glyphs():
        buffer = BytesIO()
        figure.set_facecolor("white")
        FallbackCanvas(figure).print_png(buffer, metadata={"Software": None})
        return buffer.getvalue()


def to_svg(plot: Callable[[Form], Figure], form: Form) -> str:
    """Return a plot as an SVG element whose text is text and whose colours follow the page's scheme."""
    with mpl.rc_context(dict(STYLE)), tolerate_missing_glyphs():  # the page's fonts have them
        figure, buffer = plot(form), StringIO()
        nothing: dict[str, None] = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        FigureCanvasSVG(figure).print_svg(buffer, metadata=nothing)
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", svg, flags=re.DOTALL)
    svg = re.sub(r'<svg [^>]*viewBox="([^"]*)"[^>]*>', r'<svg viewBox="\1">', svg, count=1)
    svg = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font-size: \1px", svg)
    svg = re.sub(r"; font-family: [^;\"]*", "", svg)
    svg = re.sub(r"#[0-9a-f]{6}\b", lambda found: css_color(found[0]), svg)
    svg = re.sub(r"<[^>]*>", _round_coordinates, svg)
    return _make_ids_unique(re.sub(r"\s*\n\s*", "\n", svg))


def _round_coordinates(tag: re.Match[str]) -> str:
    """Return a tag with its coordinates rounded to a hundredth of a point; the texts between tags stay."""
    return re.sub(r"\d+\.\d{3,}", lambda found: f"{float(found[0]):.2f}".rstrip("0").rstrip("."), tag[0])


def _make_ids_unique(svg: str) -> str:
    """Return the SVG with the names that it refers to made its own, and without the others."""
    used = set(re.findall(r'(?:url\(|href=")#([\w-]+)', svg))
    prefix = "c" + sha256(svg.encode()).hexdigest()[:8]
    svg = re.sub(
        r' id="([\w-]+)"', lambda found: f' id="{prefix}{found[1]}"' if found[1] in used else "", svg
    )
    svg = re.sub(r'(url\(|href=")#([\w-]+)', rf"\1#{prefix}\2", svg)
    return svg.replace("xlink:href", "href")
