"""What a bundle adjustment works on: corners, what is adjusted, and what is known beforehand."""

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
    """(N, 2) where it was found."""
    sigma_px: Array
    """(N,) one standard deviation of each coordinate."""

    @classmethod
    def of(cls, views: Iterable[tuple[int, int, Indices, Array]]) -> Observations:
        """Views one after another: camera, frame, ids (n,) and pixels (n, 2) of its corners; σ is 1 px."""
        rows = [
            (np.full(len(ids), camera), np.full(len(ids), frame), ids, px) for camera, frame, ids, px in views
        ]
        camera, frame, point, pixels = (np.concatenate(column) for column in zip(*rows, strict=True))
        return cls(camera, frame, point, pixels, np.ones(len(pixels)))


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """What is adjusted."""

    intrinsics: Array
    """(C, 9) fx, fy, cx, cy, k1, k2, p1, p2, k3."""
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
    """What is known beforehand, and what is not adjusted at all."""

    intrinsics: Array
    """(C, 9)."""
    intrinsics_information: Array
    """(C, 9, 9) inverse covariance about them; 0 says nothing."""
    intrinsics_free: NDArray[np.bool_]
    """(C, 9) what is adjusted; the rest is held where it is."""
    points_mm: Array
    """(P, 3) the nominal board."""
    points_sigma_mm: Array
    """(3,) how far a corner may lie from its nominal place in x, y, z; 0 holds the board as drawn."""
