"""Pictures of the paper's comparisons: the same colours for the same millimetres, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from beltscape.evaluate.paper.dimensions import Row
from beltscape.evaluate.paper.surfaces import Found
from beltscape.report.depth_picture import GAPS, NO_ERROR, error_colors, relief
from beltscape.report.legend import (
    DIFFERENCE,
    NEAR_TO_FAR,
    PAPER,
    QUIET,
    Rgb,
    Scale,
    keyed,
    text_width,
    write,
)
from beltscape.report.pictures import span
from beltscape.report.plots import panels, to_png

WIDE_PX = 1400
"""Width of a sheet: small enough that its words can be read on the page."""
_GAP_PX = 8
_HEAD_PX = 30
COLORS = {"paper": "#495057", "pairwise": "#e8590c", "multiview": "#1864ab", "time of flight": "#ae3ec9"}
"""Of bars."""


def side_by_side(found: Sequence[Found], titles: Mapping[str, str], *, limit_mm: float) -> Rgb:
    """Depths of the same scene by several and the truth, in a row; below it their errors.

    Parameters
    ----------
    found
        All on grids of one size.
    titles
        By whom it was measured → what stands over its picture.
    limit_mm
        Error of the fullest colours.
    """
    truth = found[0].truth.depth_mm
    near, far = span(truth, 0.002)
    scale = Scale(near, far, NEAR_TO_FAR)
    depths = [(titles[one.by], f"{one.depth.coverage:.0%} measured", one.depth.depth_mm) for one in found]
    depths.append(("truth", "", truth.astype(np.float32)))
    pictures = [(title, note, relief(values, scale)) for title, note, values in depths]
    rows = [_row(pictures, len(pictures)), keyed(scale, GAPS, WIDE_PX)]
    return np.concatenate([*rows, errors(found, titles, limit_mm=limit_mm, columns=len(pictures))])


def errors(found: Sequence[Found], titles: Mapping[str, str], *, limit_mm: float, columns: int) -> Rgb:
    """The errors of several, in rows of so many."""
    scale = Scale(-limit_mm, limit_mm, DIFFERENCE)
    pictures = []
    for one in found:
        values = one.depth.depth_mm - one.truth.depth_mm
        note = f"{one.score.depth.within_1mm:.1%} < 1 mm"
        pictures.append((f"{titles[one.by]}: error", note, error_colors(values, one.truth.depth_mm, scale)))
    rows = [_row(pictures[i : i + columns], columns) for i in range(0, len(pictures), columns)]
    return np.concatenate([*rows, keyed(scale, NO_ERROR, WIDE_PX)])


def _row(pictures: Sequence[tuple[str, str, Rgb]], columns: int) -> Rgb:
    """(title, note, picture) side by side, each a share of the width."""
    width = WIDE_PX // columns - _GAP_PX
    done = [_titled(title, note, picture, width) for title, note, picture in pictures]
    row = np.full((done[0].shape[0], WIDE_PX, 3), PAPER, np.uint8)
    for i, one in enumerate(done):
        row[:, i * (width + _GAP_PX) : i * (width + _GAP_PX) + width] = one
    return row


def _titled(title: str, note: str, picture: Rgb, width: int) -> Rgb:
    """A picture ``width`` wide under its title, the note at the right."""
    height = round(picture.shape[0] * width / picture.shape[1])
    way = cv2.INTER_AREA if width < picture.shape[1] else cv2.INTER_LINEAR
    body = np.asarray(cv2.resize(picture, (width, height), interpolation=way), np.uint8)
    head = np.full((_HEAD_PX, width, 3), PAPER, np.uint8)
    write(head, title, (0, 21), 17)
    room = width - text_width(title, 17) - 8
    if text_width(note, 13) <= room:
        write(head, note, (width - text_width(note, 13), 21), 13, QUIET)
    return np.concatenate([head, body])


def dimension_plot(rows: Sequence[Row], by: Mapping[str, str]) -> bytes:
    """Absolute errors of the dimensions on a logarithmic scale: the paper's and those of ``by`` (who → name)."""
    figure, (axis,) = panels(1, columns=1, width=9.5, height=4.8)
    who = {"paper": "the paper, as published", **by}
    place = np.arange(len(rows), dtype=np.float64)
    high = 0.8 / len(who)
    for k, (key, name) in enumerate(who.items()):
        errors = np.abs([_paper_error(row) if key == "paper" else row.error_mm(key) for row in rows])
        axis.barh(
            place + (k - (len(who) - 1) / 2) * high,
            np.maximum(errors, _LEAST_MM) - _LEAST_MM,
            high,
            left=_LEAST_MM,
            color=COLORS[key],
            label=name,
        )
    axis.set_xscale("log")
    axis.set(xlim=(_LEAST_MM, 12), xlabel="absolute error, mm", yticks=place)
    axis.set_yticklabels([row.dimension.name for row in rows])
    axis.invert_yaxis()
    axis.grid(axis="x", color="#e9ecef")
    axis.set_axisbelow(True)
    axis.legend(frameon=False, fontsize=8, loc="upper center", bbox_to_anchor=(0.4, 1.1), ncols=len(who))
    return to_png(figure)


def motion_plot(travels_mm: Sequence[float], found: Sequence[Found], ours: Found) -> bytes:
    """Share within 1 mm and median error of structured light against the belt's travel between two pictures."""
    figure, axes = panels(2, columns=2, width=4.7, height=3.2)
    x = np.array([travel if travel > 0 else _AT_REST_MM for travel in travels_mm])
    values = (
        [100 * one.score.depth.within_1mm for one in found],
        [one.score.depth.interior_median_mm for one in found],
    )
    lines = (100 * ours.score.depth.within_1mm, ours.score.depth.interior_median_mm)
    labels = ("material within 1 mm of the truth, %", "median error away from edges, mm")
    for axis, y, own, label in zip(axes, values, lines, labels, strict=True):
        axis.plot(x, y, "o-", color="#e8590c", label="structured light, 12 pictures")
        axis.axhline(own, color="#1864ab", label="Beltscape, one instant")
        axis.set_xscale("log")
        axis.set(xlabel="belt between two pictures, mm", title=label)
        axis.set_xticks(x, ["at rest" if t == 0 else f"{t:g}" for t in travels_mm], minor=False)
        axis.minorticks_off()
        axis.grid(color="#e9ecef")
    axes[0].set_ylim(0, 100)
    axes[1].set_yscale("log")
    axes[0].legend(frameon=False, fontsize=8, loc="lower left")
    return to_png(figure)


_LEAST_MM = 0.001
_AT_REST_MM = 0.01


def _paper_error(row: Row) -> float:
    return row.dimension.table2_mm - row.dimension.actual_mm
