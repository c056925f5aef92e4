"""Matplotlib plots in a common style, as SVG for pages and PNG for files, without a window system.

All panels of a chart get the same size, with the space that their ticks, labels and titles need. Texts whose
characters the charts' font lacks, such as Chinese names, are drawn by OpenCV's fonts for Latin, Cyrillic, Greek,
Chinese, Japanese, Korean and Arabic, so that a picture's bytes do not depend on the fonts of a computer.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from io import BytesIO, StringIO
from typing import TYPE_CHECKING, Any
from warnings import catch_warnings, filterwarnings

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.layout_engine import LayoutEngine
from matplotlib.ticker import ScalarFormatter
from numpy.typing import NDArray

from beltscape.report.drawing.legend import Rgb, draw_text, measure_text
from beltscape.report.drawing.palette import css_color, light

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_DESCENT = 0.25
"""Depth of the longest descenders below the base line, over the size of the text (DejaVu Sans has 0.24)."""
_INK = 255
"""Value of ink in the mask that a text is drawn into."""


@contextmanager
def tolerate_missing_glyphs() -> Generator[None]:
    """Silence Matplotlib's warnings of characters that its font lacks: others draw them."""
    with catch_warnings():
        filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        yield


class FallbackCanvas(FigureCanvasAgg):
    """Canvas of a figure as PNG."""

    def get_renderer(self) -> RendererAgg:
        """Return the renderer, which is one for all measurements and drawings of one size."""
        width, height = self.get_width_height(physical=True)
        key = (width, height, self.figure.dpi)
        if self._lastKey != key:
            self.renderer, self._lastKey = _Renderer(width, height, self.figure.dpi), key
        return self.renderer


class _Renderer(RendererAgg):
    """Renderer that draws whole texts with OpenCV's fonts where the chart's font lacks a character of them."""

    def get_text_width_height_descent(
        self, s: str, prop: FontProperties, ismath: Any
    ) -> tuple[float, float, float]:
        """Return the size of a text and its depth below the base line, px."""
        if not s or ismath or not _lacks_glyphs(s):
            return super().get_text_width_height_descent(s, prop, ismath)
        size = self._find_size(prop)
        return float(measure_text(s, size)), size * (1 + _DESCENT), size * _DESCENT

    def draw_text(
        self, gc: Any, x: float, y: float, s: str, prop: FontProperties, angle: float, ismath: Any = False,
        mtext: Any = None,
    ) -> None:  # fmt: skip
        """Draw a text from the left end of its base line, px from the left and from above."""
        if not s or ismath or not _lacks_glyphs(s):
            super().draw_text(gc, x, y, s, prop, angle, ismath, mtext)
            return
        size = self._find_size(prop)
        below = round(size * _DESCENT)
        mask: Rgb = np.zeros((size + 2 * below, measure_text(s, size) + 2, 3), np.uint8)
        draw_text(mask, s, (0, size + below), size, (_INK, _INK, _INK))
        picture = np.empty((*mask.shape[:2], 4), np.uint8)
        picture[..., :3] = np.rint(np.array(gc.get_rgb()[:3]) * 255)
        picture[..., 3] = mask[..., 0]
        quarters = round(angle / 90) % 4
        left, bottom = (x, self.height - y - below) if quarters == 0 else (x - size - below, self.height - y)
        self.draw_image(gc, round(left), round(bottom), np.rot90(picture, quarters)[::-1].copy())

    def _find_size(self, prop: FontProperties) -> int:
        return max(1, round(prop.get_size_in_points() * self.dpi / 72))


@lru_cache(maxsize=4096)
def _lacks_glyphs(text: str) -> bool:
    """Return whether the charts' font lacks a character of a text."""
    font = get_font(findfont(FontProperties(family="DejaVu Sans")))
    return any(font.get_char_index(ord(char)) == 0 for char in text if not char.isspace())


_PASSES = 3
"""Largest number of passes; ticks and the space for them depend on each other."""
_SETTLED_PX = 1.0
"""Positions that moved by less are final."""
_PAD_PT = 3.0
"""Blank margin of the chart, as in Matplotlib's own layouts."""
_GAP_PT = 8.0
"""Least blank space between panels: two thirds of a line of text."""
_LEAST_SHARE = 0.1
"""Least share of the chart for the panels themselves, where labels would leave none."""


class PanelLayout(LayoutEngine):
    """Gives all panels of a chart the same size, and each row and column the space that its labels need.

    Matplotlib's constrained layout measures every label twice in each pass, and labels of a map to scale against the
    panel's cell instead of the map, so that three passes left errors of 2 px and took half the time of a chart.
    """

    _adjust_compatible = False  # Matplotlib's own switches: no subplots_adjust, no colorbars
    _colorbar_gridspec = False

    def execute(self, fig: Figure) -> None:
        """Set the positions of the visible panels, which all belong to one grid."""
        panels = [panel for panel in fig.axes if panel.get_visible()]
        before = np.full((len(panels), 4), np.inf)
        for _ in range(_PASSES):
            boxes_px = _arrange(fig, panels)
            for panel, box in zip(panels, boxes_px / np.tile(fig.bbox.size, 2), strict=True):
                panel.set_position((box[0], box[1], box[2], box[3]))
            if np.abs(boxes_px - before).max(initial=0.0) < _SETTLED_PX:
                break
            before = boxes_px


def _arrange(figure: Figure, panels: Sequence[Axes]) -> NDArray[np.float64]:
    """Return (n, 4) left, bottom, width and height of the panels in px, by their labels as they are now."""
    cells, grid = _list_cells(panels)
    measured = [_measure_labels(panel) for panel in panels]
    pad, gap = (points * figure.dpi / 72 for points in (_PAD_PT, _GAP_PT))
    size = np.array(figure.bbox.size)
    size[1] -= _measure_title(figure)
    boxes = np.empty((len(panels), 4))
    for k in (0, 1):
        before, after = np.zeros((2, grid[k]))
        for cell, (low, high) in zip(cells[:, k], measured, strict=True):
            before[cell], after[cell] = max(before[cell], low[k]), max(after[cell], high[k])
        labels = float(before.sum() + after.sum())
        extent = max(size[k] - 2 * pad - gap * (grid[k] - 1) - labels, _LEAST_SHARE * size[k]) / grid[k]
        starts = pad + np.cumsum(before) + np.cumsum(after) - after + (extent + gap) * np.arange(grid[k])
        boxes[:, k], boxes[:, 2 + k] = starts[cells[:, k]], extent
    return boxes


def _list_cells(panels: Sequence[Axes]) -> tuple[NDArray[np.intp], tuple[int, int]]:
    """Return (n, 2) column and row, from below, of each panel, and the numbers of columns and rows."""
    cells, grid = np.zeros((len(panels), 2), np.intp), (1, 1)
    for number, panel in enumerate(panels):
        spec = panel.get_subplotspec()
        assert spec is not None
        whole = spec.get_gridspec()
        grid = whole.ncols, whole.nrows
        cells[number] = spec.colspan.start, whole.nrows - 1 - spec.rowspan.start
    return cells, grid


def _measure_labels(panel: Axes) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the space (2,) left of and below a panel that its labels take, and right of and above it, px."""
    whole = panel.get_tightbbox(for_layout_only=True)
    if whole is None:
        return np.zeros(2), np.zeros(2)
    box = panel.bbox  # the drawn box: a map to scale does not fill its cell
    return np.maximum(box.min - whole.min, 0.0), np.maximum(whole.max - box.max, 0.0)


def _measure_title(figure: Figure) -> float:
    """Return the height that the chart's own texts take at its top, px."""
    return max((figure.bbox.ymax - text.get_window_extent().ymin for text in figure.texts), default=0.0)


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


class _MarkedFormatter(ScalarFormatter):
    """Writes ticks with another decimal mark than a point."""

    def __init__(self, mark: str) -> None:
        super().__init__(useOffset=False)
        self._mark = mark

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Return the text of a tick."""
        return super().__call__(x, pos).replace(".", self._mark)


def use_decimal_mark(axes: Sequence[Axes], mark: str) -> None:
    """Write the numbers of all axes with a language's decimal mark; names that stand for ticks stay."""
    for axis in axes:
        for one in (axis.xaxis, axis.yaxis):
            if type(one.get_major_formatter()) is ScalarFormatter:
                one.set_major_formatter(_MarkedFormatter(mark))


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
