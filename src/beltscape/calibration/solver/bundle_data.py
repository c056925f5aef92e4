"""Data of a bundle adjustment: observed corners, the adjusted geometry, and the prior."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """All corners, one row each, sorted by frame."""

    camera: Indices
    """(N,) index of the camera."""
    frame: Indices
    """(N,) index of the frame, ascending."""
    point: Indices
    """(N,) index of the board's corner."""
    pixels: Array
    """(N, 2) detected position."""
    sigma_px: Array
    """(N,) one standard deviation of each coordinate."""

    @classmethod
    def from_views(cls, views: Iterable[tuple[int, int, Indices, Array]]) -> Observations:
        """Concatenate views, each as camera, frame, ids (n,) and pixels (n, 2) of its corners; σ is 1 px."""
        rows = [
            (np.full(len(ids), camera), np.full(len(ids), frame), ids, px) for camera, frame, ids, px in views
        ]
        camera, frame, point, pixels = (np.concatenate(column) for column in zip(*rows, strict=True))
        return cls(camera, frame, point, pixels, np.ones(len(pixels)))


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """The quantities that the bundle adjustment estimates."""

    intrinsics: Array
    """(C, W) fx, fy, cx, cy and the coefficients of each camera's lens model, zeros beyond them."""
    cam_rotation: Array
    """(C, 3, 3) cam_from_core; camera 0 is the core."""
    cam_translation_mm: Array
    """(C, 3)."""
    board_rotation: Array
    """(F, 3, 3) core_from_board."""
    board_translation_mm: Array
    """(F, 3)."""
    points_mm: Array
    """(P, 3) the board's corners in its own frame."""


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
