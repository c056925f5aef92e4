"""Balls on a fused belt: exact heights over the empty belt on cells of 2 mm, and the ball on top of each cell."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.pose import Pose
from beltscape.core.height_map import HeightMap
from beltscape.files.fused_belt import FusedBelt
from beltscape.files.json_text import write_json
from beltscape.files.tiff import write_float_tiff

CELL_MM = 2.0
COLUMNS = 100
"""Cells across; stretches are three times as long, and one width of it is shared."""
S_MM = 500.0
"""Position of the first row along the belt."""

Ball = tuple[float, float, float]
"""x, s and radius in mm; it lies on the belt."""


def make_belt(
    balls: Sequence[Ball], rows: int, cell_mm: float = CELL_MM
) -> tuple[FusedBelt, NDArray[np.int32]]:
    """Return a belt with balls, and (rows, columns) the number of the ball on top of each cell, -1: none."""
    columns = round(COLUMNS * CELL_MM / cell_mm)
    x, s = np.meshgrid(
        (np.arange(columns) - (columns - 1) / 2) * cell_mm, S_MM + cell_mm * np.arange(rows), indexing="xy"
    )
    tops = [np.zeros(x.shape)]
    for middle_x, middle_s, radius in balls:
        inside = radius**2 - (x - middle_x) ** 2 - (s - middle_s) ** 2
        tops.append(np.where(inside > 0, radius + np.sqrt(np.maximum(inside, 0)), 0))
    height = np.max(tops, axis=0) + np.random.default_rng(0).normal(0, 0.05, x.shape)
    which = np.argmax(tops, axis=0).astype(np.int32) - 1
    heights = HeightMap(height, np.full(x.shape, 0.05), (float(x[0, 0]), S_MM), cell_mm)
    counted = (S_MM - 1, float(s[-1, 0]) + 1)
    return FusedBelt(heights, np.ones(x.shape), Pose.identity(), 1, {"000": S_MM}, counted, cell_mm), which


def write_belt_folder(folder: Path, belt: FusedBelt, pixel_mm: float = CELL_MM) -> None:
    """Write the folder of ``beltscape measure flow`` as far as its fused belt."""
    for name, plane in (
        ("belt", belt.heights.height_mm), ("belt_sigma", belt.heights.sigma_mm), ("belt_measured", belt.measured)
    ):  # fmt: skip
        write_float_tiff(folder / f"{name}.tiff", plane.astype(np.float32))
    pose = belt.belt_from_core
    grid = {
        "origin_mm": belt.heights.origin_mm,
        "cell_mm": belt.heights.cell_mm,
        "belt_from_core": {"rotation": pose.rotation, "translation_mm": pose.translation_mm},
    }
    strip = {"start_mm": belt.counted_mm[0], "end_mm": belt.counted_mm[1], "quality": "measured"}
    places = [{"frame": name, "position_mm": mm} for name, mm in belt.positions_mm.items()]
    write_json(
        folder / "flow.json",
        {"belt_grid": grid, "strips": [strip], "places": places, "direction": "+y", "cell_mm": pixel_mm},
    )
