"""Scores of the lumps of a fused belt against the rocks of the simulated heap that lie on top, seen from above."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.evaluate.belt_scores import TrueBelt, find_true_cells, read_true_belt, sample_places
from beltscape.evaluate.lump_scores import LumpScore, score_lumps
from beltscape.files.arrays import read_arrays
from beltscape.files.fused_belt import FusedBelt, read_fused_belt
from beltscape.measure.lumps.fused_belt import measure_belt_lumps
from beltscape.measure.lumps.lumps import Lumps
from beltscape.measure.lumps.settings import LumpSettings

_SAMPLE_MM = 1.3
"""Distance of the places at which lumps and rocks are compared: a pixel of 612 px on a load 0.6 m below."""
_MEASURED_SHARE = 0.5
"""Share of a cell that some frame measured from which on the cell counts as measured."""


def score_lumps_of_flow(flow: Path, truth: Path, settings: LumpSettings, over_mm: float) -> LumpScore:
    """Measure the lumps of a flow's fused belt and score them against the truth folder of a moving belt.

    Raises
    ------
    InputError
        If a file is missing, of an earlier program, or of another capture.
    """
    fused, belt = read_fused_belt(flow), read_true_belt(truth)
    size_mm, volume_mm3 = read_rocks(truth)
    lumps = measure_belt_lumps(fused.heights, fused.measured, settings, fused.counted_mm)
    return score_belt_lumps(lumps, fused, belt, size_mm, volume_mm3, over_mm=over_mm)


def read_rocks(truth: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return sizes in mm and volumes in mm³ (N,) of a moving heap's rocks.

    Raises
    ------
    InputError
        If the truth folder holds none.
    """
    path = truth / "belt_moving_rocks.npz"
    if not path.is_file():
        raise InputError(f"{path}: no such file; simulate a moving belt with rocks again")
    arrays = read_arrays(path)
    size, volume = (arrays[name].astype(np.float64) for name in ("size_mm", "volume_mm3"))
    return size, volume


def score_belt_lumps(
    lumps: Lumps,
    fused: FusedBelt,
    truth: TrueBelt,
    size_mm: NDArray[np.float64],
    volume_mm3: NDArray[np.float64],
    *,
    over_mm: float = 60.0,
) -> LumpScore:
    """Score the lumps of a fused belt against the rocks (N,) of the truth, on places about a pixel apart.

    Raises
    ------
    InputError
        If the truth does not know its rocks, or no frame of the flow is one of the truth's.
    """
    if truth.rock is None:
        raise InputError(
            "the truth of the moving belt holds no rocks seen from above; simulate the scene again"
        )
    times = max(1, round(fused.heights.cell_mm / _SAMPLE_MM))
    rows: list[NDArray[np.int32]] = []
    for x_mm, y_mm in sample_places(fused, truth, times):
        row, column, inside = find_true_cells(truth, x_mm, y_mm)
        rows.append(np.where(inside, truth.rock[row, column], np.int32(-1)))
    s_mm = fused.heights.y_mm[:, None]
    counted = (s_mm >= fused.counted_mm[0]) & (s_mm <= fused.counted_mm[1])
    counted = np.broadcast_to(counted, fused.heights.height_mm.shape)
    measured = counted & (fused.measured >= _MEASURED_SHARE)

    def enlarge(cells: NDArray[Any]) -> NDArray[Any]:
        return cells.repeat(times, axis=0).repeat(times, axis=1)

    return score_lumps(
        replace(lumps, labels=enlarge(lumps.labels)), np.concatenate(rows), size_mm, volume_mm3,
        pixel_mm=fused.heights.cell_mm / times, over_mm=over_mm, region=enlarge(counted), measured=enlarge(measured),
    )  # fmt: skip
