"""Scores of the fused belt of a flow against the true heights of the simulated heap.

A row of the fused belt is compared where its belt passed the rig: the frame in which it was nearest to the origin
of the belt frame says where the heap truly was. An error of the motion between distant frames thus shows as an
error of the belt's length only, as it does in the flow.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.core.geometry.pose import Pose
from beltscape.evaluate.depth_scores import GROSS_MM
from beltscape.evaluate.frame_scores import SIGMA_BINS, compute_sigma_ratios
from beltscape.evaluate.truth import read_core_from_world
from beltscape.files.arrays import read_arrays
from beltscape.files.fused_belt import FusedBelt
from beltscape.files.json_text import read_json

CELL_MM = 4.0
"""Edge, nearly, of the cells that are scored; a finer belt is averaged. Chosen: that of a belt of up to 200 m."""
LOADED_MM = 3.0
"""True mean height of a cell from which on it counts as loaded: below it are fines and the edges of lumps."""
_MEASURED_SHARE = 0.5
"""Share of a cell that some frame measured from which on the cell counts as measured."""
_SAMPLES = 4
"""Number of samples in each direction whose mean is a cell's true height; they lie about a millimetre apart. With 64
exact rays to a cell instead, 0.7 % more of the measured cells of a heap of rocks are right to 1 mm."""
_CEILING_SAMPLES = 2
"""Number of samples in each direction by which a cell counts as measurable."""
_STEP_MM = 10.0
"""Difference of true heights in a cell from which on it has a step: a third of a pixel moves its mean by 1 mm."""


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
    rock: NDArray[np.int32] | None = None
    """(Ny, Nx) number of the rock on top, -1: none; None: not known."""


class BeltCeiling(Protocol):
    """Knows what of a moving heap frames could measure: `belt_ceiling.MovingCeiling`."""

    def find_measurable(
        self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64], frames: tuple[str, ...]
    ) -> NDArray[np.bool_]:
        """Return (N,) whether one of the frames could measure the surface at x of the world and y of the heap."""
        ...


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
    steps: float
    """Share of the cells with a true step of more than 10 mm inside; their mean depends on where exactly it lies."""
    level_within_1mm: float
    """Share of the others with an error below 1 mm."""
    level_gross: float
    """Share of the others with an error above 5 mm."""
    visible: float
    """Share of the cells that some frame could measure, by true rays: the ceiling of ``measured``. NaN without the
    simulated scene, as the following."""
    visible_measured: float
    """Share of these that some frame measured."""
    visible_within_1mm: float
    """Share of these with an error below 1 mm."""
    visible_gross: float
    """Share of these with an error above 5 mm."""

    def document(self) -> dict[str, Any]:
        """Return the scores as plain values for JSON."""
        return asdict(self)


def score_belt(fused: FusedBelt, truth: TrueBelt, ceiling: BeltCeiling | None = None) -> BeltScore:
    """Score the fused belt's loaded cells against the truth, and against the ``ceiling`` where the scene is known.

    Raises
    ------
    InputError
        If no frame of the flow is one of the truth's, or no loaded cell was counted.
    """
    true_mm, range_mm = compute_true_cells(fused, truth)
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
    level = loaded & (range_mm <= _STEP_MM)
    visible = find_visible_cells(fused, truth, ceiling, loaded) if ceiling else np.zeros(loaded.shape, bool)
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
        steps=1 - _mean(level[loaded]),
        level_within_1mm=_mean(size[level] < 1),
        level_gross=_mean(size[level] > GROSS_MM),
        visible=_mean(visible[loaded]) if ceiling else np.nan,
        visible_measured=_mean(measured[visible]),
        visible_within_1mm=_mean(size[visible] < 1),
        visible_gross=_mean(size[visible] > GROSS_MM),
    )


def _mean(values: NDArray[np.floating] | NDArray[np.bool_]) -> float:
    return float(values.mean()) if values.size else np.nan


def compute_true_cells(fused: FusedBelt, truth: TrueBelt) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (Ny, Nx) the true mean height of each cell of the fused belt, and the range of its heights.

    Both are NaN outside the heap's own heights.

    Raises
    ------
    InputError
        If no frame of the flow is one of the truth's.
    """
    mean, extent = (np.empty(fused.heights.height_mm.shape) for _ in range(2))
    for row, (x_mm, y_mm) in enumerate(sample_places(fused, truth, _SAMPLES)):
        heights = _sample(truth, x_mm, y_mm).reshape(_SAMPLES, -1, _SAMPLES)
        mean[row] = heights.mean(axis=(0, 2))
        extent[row] = heights.max(axis=(0, 2)) - heights.min(axis=(0, 2))
    return mean, extent


def find_visible_cells(
    fused: FusedBelt, truth: TrueBelt, ceiling: BeltCeiling, cells: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return which of the ``cells`` (Ny, Nx) some frame of the flow could measure at half of their samples."""
    n, places = _CEILING_SAMPLES, sample_places(fused, truth, _CEILING_SAMPLES)
    of_cells = [
        np.stack(place).reshape(2, n, -1, n)[:, :, own].transpose(0, 2, 1, 3)
        for place, own in zip(places, cells, strict=True)
    ]
    x_mm, y_mm = np.concatenate(of_cells, axis=1).reshape(2, -1)
    found = ceiling.find_measurable(x_mm, y_mm, _list_frames(fused, truth))
    visible = np.zeros(cells.shape, bool)
    visible[cells] = found.reshape(-1, n * n).mean(axis=1) >= _MEASURED_SHARE
    return visible


def _list_frames(fused: FusedBelt, truth: TrueBelt) -> tuple[str, ...]:
    """Return the frames of the flow that are the truth's; InputError without any."""
    frames = tuple(name for name in fused.positions_mm if name in truth.heap_mm)
    if not frames:
        raise InputError("no frame of the flow is one of the truth's; give both of one capture")
    return frames


def sample_places(
    fused: FusedBelt, truth: TrueBelt, samples: int
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Yield for each row of cells the places (samples, Nx · samples) in it: x of the world, y of the heap.

    Raises
    ------
    InputError
        If no frame of the flow is one of the truth's.
    """
    frames = _list_frames(fused, truth)
    positions = np.array([fused.positions_mm[name] for name in frames])
    world_from_belt = (fused.belt_from_core @ truth.core_from_world).inverse()
    within = fused.heights.cell_mm * ((np.arange(samples) + 0.5) / samples - 0.5)
    x = (fused.heights.x_mm[:, None] + within).ravel()
    for middle_mm in fused.heights.y_mm:
        nearest = int(np.abs(positions - middle_mm).argmin())
        y = fused.direction * (positions[nearest] - (middle_mm + within))
        points = np.zeros((samples, len(x), 3))
        points[..., 0], points[..., 1] = x, y[:, None]
        world = world_from_belt.apply(points)
        yield world[..., 0], world[..., 1] - truth.heap_mm[frames[nearest]]


def _sample(truth: TrueBelt, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the height of the nearest true cell; NaN outside."""
    rows, columns, inside = find_true_cells(truth, x_mm, y_mm)
    return np.where(inside, truth.height_mm[rows, columns], np.nan)


def find_true_cells(
    truth: TrueBelt, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
    """Return row and column of the nearest true cell, and which of the places lie inside the truth."""
    at: list[NDArray[np.intp]] = []
    inside = np.ones(x_mm.shape, bool)
    for values, nodes in ((y_mm, truth.y_mm), (x_mm, truth.x_mm)):
        index = np.rint((values - nodes[0]) / (nodes[1] - nodes[0])).astype(np.intp)
        inside &= (index >= 0) & (index < len(nodes))
        at.append(index.clip(0, len(nodes) - 1))
    return at[0], at[1], inside


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
    rock = arrays["rock"].astype(np.int32) if "rock" in arrays else None
    return TrueBelt(x, y, height, heaps, read_core_from_world(folder), rock)
