"""Scores of the fused belt of a flow against the true heights of the simulated heap.

A row of the fused belt is compared where its belt passed the rig: the frame in which it was nearest to the origin
of the belt frame says where the heap truly was. An error of the motion between distant frames thus shows as an
error of the belt's length only, as it does in the flow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.core.geometry.pose import Pose
from beltscape.core.height_map import HeightMap
from beltscape.evaluate.depth_scores import GROSS_MM
from beltscape.evaluate.frame_scores import SIGMA_BINS, compute_sigma_ratios
from beltscape.evaluate.truth import read_core_from_world
from beltscape.files.arrays import read_arrays
from beltscape.files.json_text import read_json
from beltscape.files.tiff import read_float_tiff

LOADED_MM = 3.0
"""True mean height of a cell from which on it counts as loaded: below it are fines and the edges of lumps."""
_MEASURED_SHARE = 0.5
"""Share of a cell that some frame measured from which on the cell counts as measured."""
_SAMPLES = 4
"""Number of samples in each direction whose mean is a cell's true height; they lie about a millimetre apart."""


@dataclass(frozen=True, slots=True, eq=False)
class FusedBelt:
    """The fused belt of a flow, as its folder holds it."""

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


@dataclass(frozen=True, slots=True, eq=False)
class TrueBelt:
    """The true heights of the load on a moving belt."""

    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    height_mm: NDArray[np.float64]
    """(Ny, Nx) on x of the world and y from the middle of the heap."""
    heap_mm: Mapping[str, float]
    """By frame: y of the heap's middle in the world."""
    core_from_world: Pose


@dataclass(frozen=True, slots=True)
class BeltScore:
    """Scores of the loaded cells of a fused belt; heights in mm, NaN for an empty set."""

    cells: int
    """Cells that are truly loaded, on counted belt."""
    measured: float
    """Share of them that some frame measured; the others are filled."""
    within_1mm: float
    """Share of them with an error below 1 mm, measured or filled."""
    within_2mm: float
    gross: float
    """Share of them with an error above 5 mm, measured or filled."""
    measured_gross: float
    """Share of the measured ones with an error above 5 mm."""
    median_mm: float
    """Median of the absolute error of the measured ones."""
    bias_mm: float
    """Mean error of all of them: what the volume gets."""
    filled_bias_mm: float
    """Mean error of the filled ones."""
    sigma_ratio_low: float
    """Actual over predicted σ of the measured ones, smallest over the fifths of predicted σ."""
    sigma_ratio_high: float
    """Largest over the fifths."""

    def document(self) -> dict[str, Any]:
        """Return the scores as plain values for JSON."""
        return asdict(self)


def score_belt(fused: FusedBelt, truth: TrueBelt) -> BeltScore:
    """Score the fused belt's loaded cells against the truth.

    Raises
    ------
    InputError
        If no frame of the flow is one of the truth's, or no loaded cell was counted.
    """
    true_mm = compute_true_cells(fused, truth)
    s_mm = fused.heights.y_mm[:, None]
    counted = (s_mm >= fused.counted_mm[0]) & (s_mm <= fused.counted_mm[1])
    error = fused.heights.height_mm - true_mm
    loaded = counted & (true_mm >= LOADED_MM) & np.isfinite(error)
    if not loaded.any():
        raise InputError(
            "no loaded cell of the fused belt lies where the truth has a heap; give both of one capture"
        )
    measured = loaded & (fused.measured >= _MEASURED_SHARE)
    size, filled = np.abs(error), loaded & ~measured
    near = measured & (size <= GROSS_MM)
    ratios = (
        compute_sigma_ratios(error[near], fused.heights.sigma_mm[near])
        if near.sum() >= SIGMA_BINS
        else np.full(SIGMA_BINS, np.nan)
    )
    return BeltScore(
        cells=int(loaded.sum()),
        measured=_mean(measured[loaded]),
        within_1mm=_mean(size[loaded] < 1),
        within_2mm=_mean(size[loaded] < 2),
        gross=_mean(size[loaded] > GROSS_MM),
        measured_gross=_mean(size[measured] > GROSS_MM),
        median_mm=float(np.median(size[measured])) if measured.any() else np.nan,
        bias_mm=_mean(error[loaded]),
        filled_bias_mm=_mean(error[filled]),
        sigma_ratio_low=float(ratios.min()),
        sigma_ratio_high=float(ratios.max()),
    )


def _mean(values: NDArray[np.floating] | NDArray[np.bool_]) -> float:
    return float(values.mean()) if values.size else np.nan


def compute_true_cells(fused: FusedBelt, truth: TrueBelt) -> NDArray[np.float64]:
    """Return (Ny, Nx) the true mean height of each cell of the fused belt; NaN outside the heap's own heights.

    Raises
    ------
    InputError
        If no frame of the flow is one of the truth's.
    """
    frames = [name for name in fused.positions_mm if name in truth.heap_mm]
    if not frames:
        raise InputError("no frame of the flow is one of the truth's; give both of one capture")
    positions = np.array([fused.positions_mm[name] for name in frames])
    heaps = np.array([truth.heap_mm[name] for name in frames])
    world_from_belt = (fused.belt_from_core @ truth.core_from_world).inverse()
    cell = fused.heights.cell_mm
    within = cell * ((np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5)
    x = (fused.heights.x_mm[:, None] + within).ravel()
    result = np.empty(fused.heights.height_mm.shape)
    for row, middle_mm in enumerate(fused.heights.y_mm):
        nearest = int(np.abs(positions - middle_mm).argmin())
        y = fused.direction * (positions[nearest] - (middle_mm + within))
        points = np.zeros((_SAMPLES, len(x), 3))
        points[..., 0], points[..., 1] = x, y[:, None]
        world = world_from_belt.apply(points)
        heights = _sample(truth, world[..., 0], world[..., 1] - heaps[nearest])
        result[row] = heights.reshape(_SAMPLES, -1, _SAMPLES).mean(axis=(0, 2))
    return result


def _sample(truth: TrueBelt, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the height of the nearest true cell; NaN outside."""
    at: list[NDArray[np.intp]] = []
    inside = np.ones(x_mm.shape, bool)
    for values, nodes in ((y_mm, truth.y_mm), (x_mm, truth.x_mm)):
        index = np.rint((values - nodes[0]) / (nodes[1] - nodes[0])).astype(np.intp)
        inside &= (index >= 0) & (index < len(nodes))
        at.append(index.clip(0, len(nodes) - 1))
    return np.where(inside, truth.height_mm[at[0], at[1]], np.nan)


def read_fused_belt(folder: Path) -> FusedBelt:
    """Read the fused belt of a folder of ``beltscape measure flow``.

    Raises
    ------
    InputError
        If a file is missing or of an earlier program, or the belt stood still.
    """
    path = folder / "flow.json"
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
    )


def read_true_belt(folder: Path) -> TrueBelt:
    """Read the true heights of a moving belt from the truth folder of ``beltscape simulate``.

    Raises
    ------
    InputError
        If a file is missing or of an earlier program.
    """
    path = folder / "belt_moving_load.npz"
    if not path.is_file():
        raise InputError(f"{path}: no such file; give truth/ of a moving belt by beltscape simulate")
    arrays = read_arrays(path)
    if not {"x_mm", "y_mm", "height_mm"} <= set(arrays):
        raise InputError(f"{path}: holds no heights; simulate the scene again")
    moving = read_json(folder / "belt_moving.json")
    try:
        heaps = {one["frame"]: float(one["heap_mm"]) for one in moving["frames"]}
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{folder}: holds no truth of a moving belt ({error!r}); simulate the scene again"
        ) from error
    x, y, height = (arrays[name].astype(np.float64) for name in ("x_mm", "y_mm", "height_mm"))
    return TrueBelt(x, y, height, heaps, read_core_from_world(folder))
