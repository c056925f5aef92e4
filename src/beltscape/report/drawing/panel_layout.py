"""The positions of a chart's panels, with the space that their ticks, labels and titles need."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.layout_engine import LayoutEngine
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
