"""Report sections of Tables 2 and 3 with Fig. 17, and the module's dimensions by the baseline sensors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltscape.evaluate.paper.dimensions import DimensionRow
from beltscape.evaluate.paper.experiments import Paper
from beltscape.evaluate.paper.features import PLAIN
from beltscape.evaluate.paper.pages.formatting import METRICS, format_metrics, format_number, format_signed
from beltscape.evaluate.paper.pages.pictures import make_depth_panels, make_dimension_chart, make_error_panels
from beltscape.evaluate.paper.surfaces import TITLES
from beltscape.evaluate.paper.tof import SMOOTHED_PX, TOF
from beltscape.report.page import Item, Pictures, Section, Table

TOF_ERROR_MM = 10.0
"""Limit of the colour scale of the time-of-flight camera's errors, ten times that of the others."""


def make_table2_section(paper: Paper) -> list[Section]:
    """Return Table 2 as published, by the paper's method and by Beltscape; empty without the module."""
    if not paper.dimensions:
        return []
    columns = [
        "dimension", "true mm", "the paper", "error", "its method", "error", "Beltscape", "error", "σ", "plain too",
    ]  # fmt: skip
    rows = [_table2_row(row) for row in paper.dimensions]
    intro = (
        "“The paper” is its real module, made to ±0.2 mm and measured by hand in CloudCompare. The others are "
        "measured without hints, as `measure features` does: the paper's method from its points alone, "
        "Beltscape with the image that it matched by, and in the last column with an image without speckle, "
        "too. “–”: not found. The last row is the mean of the three steps."
    )
    items: list[Item] = [
        Table(columns, rows),
        make_dimension_chart(
            paper.dimensions, {"pairwise": TITLES["pairwise"] + ", here", "multiview": "Beltscape"}
        ),
    ]
    return [Section("Table 2: dimensions of the calibration module", intro, items)]


def _table2_row(row: DimensionRow) -> list[str]:
    d = row.dimension
    plain = row.error_mm(PLAIN) if PLAIN in row.measured_mm else np.nan
    return [
        d.name, f"{d.actual_mm:g}", f"{d.table2_mm:.3f}", format_signed(d.table2_mm - d.actual_mm),
        format_number(row.measured_mm["pairwise"], 3), format_signed(row.error_mm("pairwise")),
        format_number(row.measured_mm["multiview"], 3), format_signed(row.error_mm("multiview")),
        format_number(row.sigma_mm["multiview"], 3), format_signed(plain),
    ]  # fmt: skip


def make_table3_section(paper: Paper) -> list[Section]:
    """Return Table 3 and Fig. 17; empty without a time-of-flight camera."""
    if paper.tof is None:
        return []
    tof = paper.tof
    items: list[Item] = []
    rows = [_table3_row(row) for row in paper.dimensions]
    columns = [
        "dimension",
        "true mm",
        "paper's camera",
        "error",
        "simulated camera",
        "error",
        "Beltscape error",
    ]
    if rows:
        items.append(Table(columns, rows))
    items += [
        Pictures(
            [
                *make_depth_panels([tof], {TOF: TOF}),
                *make_error_panels([tof], {TOF: TOF}, limit_mm=TOF_ERROR_MM),
            ],
            "Fig. 17: what the camera gives, the truth on its grid, and its error: edges fly, the belt is noisy.",
            columns=3,
        ),
        Table(["surface", *METRICS], [[f"module, {TOF}", *format_metrics(tof)]]),
    ]
    intro = (
        "A camera of the geometry that the paper names (640 × 480, 43° × 33°) with an ordinary camera's "
        "wiggling, multipath, flying pixels and noise: the paper does not state its own. Dimensions are "
        f"measured after a median over {SMOOTHED_PX} × {SMOOTHED_PX} pixels."
    )
    return [Section("Table 3 and Fig. 17: time of flight", intro, items)]


def _table3_row(row: DimensionRow) -> list[str]:
    d = row.dimension
    theirs = np.nan if d.table3_mm is None else d.table3_mm
    return [
        d.name, f"{d.actual_mm:g}", format_number(theirs, 3), format_signed(theirs - d.actual_mm),
        format_number(row.measured_mm[TOF], 3), format_signed(row.error_mm(TOF)),
        format_signed(row.error_mm("multiview")),
    ]  # fmt: skip


def make_baseline_table(paper: Paper, names: Sequence[str]) -> Table:
    """Return the errors of the module's dimensions by Beltscape and the given sensors."""
    columns = ["dimension", "Beltscape", *(name.replace("structured light, ", "") for name in names)]
    rows = [
        [row.dimension.name,
         *(format_signed(row.error_mm(by)) if by in row.measured_mm else "–" for by in ("multiview", *names))]
        for row in paper.dimensions
    ]  # fmt: skip
    text = "Errors of the module's dimensions, mm. For edges structured light has an evenly lit image, too."
    return Table(columns, rows, text)
