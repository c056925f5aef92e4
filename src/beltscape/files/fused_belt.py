"""The fused belt in a folder of ``beltscape measure flow``: heights, σ and what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.core.geometry.pose import Pose
from beltscape.core.height_map import HeightMap, coarsen
from beltscape.files.json_text import read_json
from beltscape.files.tiff import read_float_tiff

FLOW_DOCUMENT = "flow.json"
"""File by which the folder of a flow is recognised."""


@dataclass(frozen=True, slots=True, eq=False)
class FusedBelt:
    """The fused belt of a flow."""

    heights: HeightMap
    """On x and the belt coordinate s."""
    measured: NDArray[np.float64]
    """(Ny, Nx) share of each cell that some frame measured."""
    belt_from_core: Pose
    direction: int
    """+1 for a belt that travels towards +y, else -1."""
    positions_mm: Mapping[str, float]
    """By frame: the measured position of the belt."""
    counted_mm: tuple[float, float]
    """Stretch of belt that was counted, in s."""
    finest_cell_mm: float = 0.0
    """Edge of the cells that were fused, one pixel wide: finer ones of ``heights`` hold no more; 0 if not known."""

    def coarsen(self, cell_mm: float) -> FusedBelt:
        """Return the belt with cells near an edge, the means of the present ones."""
        heights, measured = coarsen(self.heights, self.measured, cell_mm)
        return replace(self, heights=heights, measured=measured)


def holds_fused_belt(folder: Path) -> bool:
    """Return whether a folder is one of ``beltscape measure flow``."""
    return (folder / FLOW_DOCUMENT).is_file()


def read_fused_belt(folder: Path) -> FusedBelt:
    """Read the fused belt of a folder of ``beltscape measure flow``.

    Raises
    ------
    InputError
        If a file is missing or of an earlier program, or the belt stood still.
    """
    path = folder / FLOW_DOCUMENT
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the --out folder of beltscape measure flow")
    document = read_json(path)
    try:
        grid, strips = document["belt_grid"], document["strips"]
        pose = Pose.of(grid["belt_from_core"]["rotation"], grid["belt_from_core"]["translation_mm"])
        origin, cell = grid["origin_mm"], float(grid["cell_mm"])
        places = {one["frame"]: one["position_mm"] for one in document["places"]}
        direction = {"+y": 1, "-y": -1, None: 1}[document["direction"]]  # the meter assumes +y
        counted = [one for one in strips if one["quality"] != "missing"]
        ends = [float(mm) for one in counted for mm in (one["start_mm"], one["end_mm"])]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: holds no fused belt with its pose ({error!r}); measure the flow again"
        ) from error
    if not ends:
        raise InputError(f"{path}: no belt was counted in it; give a flow with valid strips")
    planes = [read_float_tiff(folder / f"{name}.tiff") for name in ("belt", "belt_sigma", "belt_measured")]
    height, sigma, measured = (plane.astype(np.float64) for plane in planes)
    return FusedBelt(
        HeightMap(height, sigma, (float(origin[0]), float(origin[1])), cell),
        measured,
        pose,
        direction,
        {frame: float(mm) for frame, mm in places.items() if mm is not None},
        (min(ends), max(ends)),
        float(document.get("cell_mm", 0.0)),
    )
