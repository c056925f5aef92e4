"""Prior knowledge of a bundle adjustment: the lenses, and where the corners of the board are."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array

PRINT_STRETCH = 3e-3
"""One standard deviation of the stretch of a print in one direction and of its shear: laser printers have 1e-3 to
5e-3. Without it a stretch counts as an error of every corner by itself, half of it stays in the pixels' aspect ratio,
and focal lengths in x and y are off by 0.1 % where the board is never turned on its side. One camera alone does not
tell the two apart: of a webcam with twelve corners a view, the lens holds out at 0.07 px with it, at 0.06 without."""
RIGID_SIGMA_MM = 1e-3
"""Standard deviation of the corners of a board that moves as a whole but keeps its shape, of which none is fixed."""
GAUGE = 1e8
"""Information that fixes the board's seven gauge modes (pose and scale) at their nominal values."""


@dataclass(frozen=True, slots=True, eq=False)
class BundlePrior:
    """Prior knowledge of lenses and board, and which parameters are fixed."""

    models: tuple[str, ...]
    """(C,) name of each camera's lens model."""
    intrinsics: Array
    """(C, W) as in `Geometry`."""
    intrinsics_information: Array
    """(C, W, W) inverse covariance about them; 0 is no information."""
    intrinsics_free: NDArray[np.bool_]
    """(C, W) which parameters are adjusted; the others are fixed, as are those that a model does not have."""
    points_mm: Array
    """(P, 3) the nominal board."""
    points_sigma_mm: Array
    """(3,) one standard deviation of a corner about its nominal position in x, y, z; 0 fixes it there."""
    fixed_poses: tuple[int, ...] = ()
    """Cameras, by number, whose pose is fixed; the core's, 0, always is."""
    loose_corners: tuple[slice, ...] = ()
    """The corners of each board that may move as a whole against the others, which are the first ones."""
    loose_sigma: Array = field(default_factory=lambda: np.zeros(6))
    """(6,) one standard deviation of their turns about x, y, z, rad, and of their shifts, mm."""


def build_board_information(prior: BundlePrior) -> Array:
    """Return the information (3P, 3P) of the corners' places, with the gauge of the boards that are not loose."""
    firm = np.ones(len(prior.points_mm), bool)
    for corners in prior.loose_corners:
        firm[corners] = False
    gauge = _build_gauge_modes(prior.points_mm, firm)
    return _build_shape_information(prior) + GAUGE * gauge.T @ gauge


def _build_shape_information(prior: BundlePrior) -> Array:
    """Return the information (3P, 3P) of the corners about the drawing.

    Each is off by itself, the print is stretched, and loose boards are off as a whole.
    """
    points, sigma = len(prior.points_mm), prior.points_sigma_mm
    with np.errstate(divide="ignore"):
        each = np.where(sigma > 0, sigma**-2.0, 0.0)
    weights, modes = np.tile(each, points), build_loose_modes(prior)
    if len(prior.models) >= 2 and (sigma[:2] > RIGID_SIGMA_MM).all():
        modes = np.concatenate([modes, PRINT_STRETCH * _build_stretch_modes(prior.points_mm)])
    weighted = modes * weights
    inner = np.eye(len(modes)) + weighted @ modes.T
    return np.asarray(np.diag(weights) - weighted.T @ np.linalg.solve(inner, weighted), np.float64)


def _build_gauge_modes(points_mm: Array, firm: NDArray[np.bool_]) -> Array:
    """Return the orthonormal gauge modes (7, 3P) of the ``firm`` corners (P,): shifts, turns and scale."""
    centered = np.where(firm[:, None], points_mm - points_mm[firm].mean(axis=0), 0.0)
    modes = np.concatenate([_build_rigid_modes(centered, firm), centered.reshape(1, -1)])
    return np.linalg.qr(modes.T)[0].T


def _build_rigid_modes(centered: Array, which: NDArray[np.bool_]) -> Array:
    """Return the moves (6, 3P) of corners (P,) by a unit shift in x, y, z and a unit turn about each axis."""
    shifts = [which[:, None] * axis for axis in np.eye(3)]
    turns = [np.cross(axis, centered) for axis in np.eye(3)]
    return np.stack([mode.ravel() for mode in (*shifts, *turns)])


def build_loose_modes(prior: BundlePrior) -> Array:
    """Return the moves (6L, 3P) of the L loose boards' corners by one standard deviation of each shift and turn."""
    found = [np.zeros((0, prior.points_mm.size))]
    for corners in prior.loose_corners:
        which = np.zeros(len(prior.points_mm), bool)
        which[corners] = True
        centered = np.where(which[:, None], prior.points_mm - prior.points_mm[corners].mean(axis=0), 0.0)
        found.append(np.roll(prior.loose_sigma, 3)[:, None] * _build_rigid_modes(centered, which))
    return np.concatenate(found)


def _build_stretch_modes(points_mm: Array) -> Array:
    """Return the moves (2, 3P) of corners by a unit stretch of x over y, and by a unit shear, mm."""
    x, y, _ = (points_mm - points_mm.mean(axis=0)).T
    none = np.zeros_like(x)
    return np.stack([np.stack([x, -y, none], axis=1).ravel() / 2, np.stack([y, x, none], axis=1).ravel() / 2])
