"""Heights for cells that were not measured, from the rims of their holes, and for the rims themselves."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.kernels.arrays import CellIndices
from beltscape.measure.holes.edge_fattening import brinks
from beltscape.measure.holes.features import around, features
from beltscape.measure.holes.quadrics import quadrics
from beltscape.measure.holes.rim_profiles import WINDOWS, Expected, Outlook, expected, outlook
from beltscape.measure.holes.rims import gradients, hollows, lines_through, lowest_through
from beltscape.measure.network import Network, load_network

_RATIOS = (-5.0, 5.0)
"""Heights may be so many scales from the smooth surface."""


@dataclass(frozen=True, slots=True, eq=False)
class Filled:
    """A field without holes."""

    value_mm: NDArray[np.float64]
    """(Ny, Nx) measured values, less what of brinks lies beyond the edge, and interpolated ones in the holes."""
    sigma_mm: NDArray[np.float64]
    """(Ny, Nx) one standard deviation; in the holes from what their rims leave open."""
    hole: NDArray[np.bool_]
    """(Ny, Nx) what was not measured."""


@dataclass(frozen=True, slots=True, eq=False)
class HoleView:
    """What H hole cells see, row by row."""

    look: Outlook
    """Along lines."""
    ahead: Expected
    """A smooth surface, and how much is open."""
    features: NDArray[np.float32]
    """(H, F)."""


def fill_holes(
    value_mm: NDArray[np.float64],
    sigma_mm: NDArray[np.float64],
    pinhole: NDArray[np.bool_],
    cell_mm: float,
    lean: NDArray[np.float64] | None = None,
    *,
    windowed: bool = False,
    rows: slice = slice(None),
    networks: tuple[Network, Network] | None = None,
) -> Filled:
    """Fill the NaN cells of a field (Ny, Nx) of heights over the belt.

    Each hole cell looks to the rims of its hole along five lines: across, along, both diagonals, and that on which
    the camera looks (``lean`` (2, Ny, Nx): tangents of the rays' slant in x and y; None: from straight above).
    A quadratic through the measured cells about it tells how a smooth surface would go on: where they follow
    one, it does. Else that is open by as much as the rims differ and the measured surface is uneven, and a small
    network tells, from ratios and angles of all that is seen, where in this range the mean of such cells lies and how
    much they scatter. Where the heights are those of one frame that a matcher's windows measured (``windowed``), a
    second one does so for the last measured cells beside drops (`brinks`). Both (``networks``; None: the shipped
    ones) were fitted by the mean square to simulated heaps and modules whose truth
    is known (tools/fit_holes.py): so what is summed over many cells, a volume, is right in the mean.

    No cell is put below both its lowest rim and the belt, or above both its highest rim and the smooth surface.
    Beyond the outermost measured cells the nearest ones continue. ``pinhole`` (Ny, Nx) are gaps between points of
    neighbouring pixels. Outside of ``rows`` holes are looked over, not filled.

    Raises
    ------
    ValueError
        if nothing was measured.
    """
    hole = ~np.isfinite(value_mm)
    if hole.all():
        raise ValueError("nothing to interpolate from")
    asked = np.zeros_like(hole)
    asked[rows] = hole[rows]
    if not asked.any():
        return Filled(value_mm, sigma_mm, hole)
    inside, beside = networks or (load_network("holes"), load_network("brinks"))
    slant = np.zeros((2, *hole.shape)) if lean is None else lean
    value, sigma = value_mm.copy(), sigma_mm.copy()
    place = np.nonzero(asked)
    view = hole_view(value_mm, pinhole, cell_mm, slant, place)
    value[place], spread = _told(view, inside)
    sigma[place] = np.hypot(spread, float(np.median(sigma_mm[np.isfinite(sigma_mm)])))
    if windowed:
        edge = brinks(value_mm, slant, cell_mm)
        too_high, doubt = edge.beyond(beside)
        value[edge.place] -= too_high
        sigma[edge.place] = np.hypot(sigma[edge.place], doubt)
    lost = asked & ~np.isfinite(value)
    if lost.any():
        _continue(value, sigma, lost)
    return Filled(value, sigma, hole)


def hole_view(
    value_mm: NDArray[np.float64],
    pinhole: NDArray[np.bool_],
    cell_mm: float,
    lean: NDArray[np.float64],
    place: CellIndices,
) -> HoleView:
    """What the hole cells ``place`` of a field (Ny, Nx) see."""
    calm = _calmed(value_mm, ~np.isfinite(value_mm))
    lines = lines_through(calm, place, gradients(value_mm, cell_mm), lean, cell_mm)
    look, lowest = outlook(lines), lowest_through(lines, calm, place, cell_mm)
    smooth = quadrics(value_mm, place, WINDOWS)
    ahead = expected(look, smooth, hollows(value_mm, cell_mm), cell_mm)
    about = around(value_mm, calm, place, cell_mm)
    slant = np.hypot(lean[0][place], lean[1][place])
    return HoleView(look, ahead, features(look, lowest, ahead, smooth, about, pinhole[place], slant, cell_mm))


def _told(view: HoleView, network: Network) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and spread (H,) of what may lie there, by the network; NaN where no line meets two rims."""
    offset, sigma = network.predict_mean_and_sigma(view.features)
    base, scale, floor = view.ahead.base_mm, view.ahead.scale_mm, view.look.floor_mm
    mean = base + scale * np.clip(offset, *_RATIOS)
    # nothing measured says of a hollow that it reaches below the belt
    return np.clip(mean, np.fmin(floor, 0.0), np.fmax(view.look.ceiling_mm, base)), scale * sigma


def _calmed(value: NDArray[np.float64], hole: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Rim cells replaced by the median of the measured cells about them: one flying pixel moves no hole."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    rows, columns = np.nonzero((cv2.dilate(hole.view(np.uint8), cross) > 0) & ~hole)
    padded = np.pad(value, 1, constant_values=np.nan)
    about = np.stack([padded[rows + i, columns + j] for i in range(3) for j in range(3)])
    about.sort(axis=0)  # NaN goes last
    number = np.isfinite(about).sum(axis=0)
    calm = value.copy()
    pick = np.arange(len(rows))
    calm[rows, columns] = 0.5 * (about[(number - 1) // 2, pick] + about[number // 2, pick])
    return calm


def _continue(value: NDArray[np.float64], sigma: NDArray[np.float64], lost: NDArray[np.bool_]) -> None:
    """Outside, where only one rim tells anything: the nearest known cell's value, the whole field's relief as σ."""
    known = np.isfinite(value)
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    assert isinstance(nearest, np.ndarray)
    near = tuple(part[lost] for part in nearest)
    sigma[lost] = np.hypot(sigma[near], float(np.std(value[known])))
    value[lost] = value[near]
