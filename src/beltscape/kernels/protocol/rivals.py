"""The protocol of rivals: which surfaces compete for a doubtful pixel, and how like the images they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

RIVALS = 9
"""A pixel's own surface, then one from each of eight directions."""


class Rivals(NamedTuple):
    """Surfaces that compete for N pixels, a row each; NaN where a direction has none."""

    s: NDArray[np.floating]
    """(9, N) float32 nearness at the pixel; the first row is its own."""
    slope_u: NDArray[np.floating]
    """(9, N) float32."""
    slope_v: NDArray[np.floating]
    """(9, N) float32."""
    distance: NDArray[np.floating]
    """(9, N) float32, steps to the pixel that hands it on."""
    support: NDArray[np.floating]
    """(9, N) float32, the sum of 1 / (1 + distance) of the other directions' that say the same."""


class Likenesses(NamedTuple):
    """Squared differences of levels over their variance: of the pixel, and the mean of it and the four beside it.

    ``least``, ``second``, ``mean`` and ``most`` of the views that see it: 50 where none does, and at most that.
    """

    point_least: NDArray[np.floating]
    """(C, N) float32, as all of these."""
    point_second: NDArray[np.floating]
    """The least where one view sees it."""
    point_mean: NDArray[np.floating]
    point_most: NDArray[np.floating]
    cross_least: NDArray[np.floating]
    cross_second: NDArray[np.floating]
    cross_mean: NDArray[np.floating]
    cross_most: NDArray[np.floating]
    views: NDArray[np.floating]
    """How many views see it."""


class Contends(Protocol):
    """Rivals for doubtful pixels, and what speaks for each."""

    def rivals(
        self,
        s: NDArray[np.floating],
        slope_u: NDArray[np.floating],
        slope_v: NDArray[np.floating],
        trusted: NDArray[np.uint8],
        u: NDArray[np.integer],
        v: NDArray[np.integer],
        *,
        reach: int,
        same: float,
        threads: int = 0,
    ) -> Rivals:
        """The surfaces that N pixels (u, v) might have.

        In each of eight directions (in rows: upper left, above, upper right, left, …) the first trusted pixel
        with a finite s within ``reach`` steps hands on its plane, its slopes within ±1.5; slopes that are not
        finite count as 0. A step along a diagonal is one pixel across and one down.

        Parameters
        ----------
        s, slope_u, slope_v
            (H, W) nearness and its slopes per px.
        trusted
            (H, W) uint8 or bool; where 0, a pixel hands nothing on.
        u, v
            (N,) columns and rows, within the grid.
        same
            Rivals closer than this in s say the same.
        """
        ...

    def likenesses(
        self,
        u: NDArray[np.integer],
        v: NDArray[np.integer],
        s: NDArray[np.floating],
        slope_u: NDArray[np.floating],
        slope_v: NDArray[np.floating],
        *,
        core: NDArray[np.floating],
        variance: NDArray[np.floating],
        images: Sequence[NDArray[np.floating]],
        views: NDArray[np.floating],
        buffers: Sequence[NDArray[np.floating]],
        gains: Sequence[NDArray[np.floating]],
        tolerance: float,
        threads: int = 0,
    ) -> Likenesses:
        """How like the core's levels those of the auxiliaries are on small planes at N pixels, C for each.

        A level differs from the core's by (I - gain · J)² / variance, with the gain of the pixel and J sampled
        bilinearly where the auxiliary sees the plane; the core's edge stands for what lies beyond it.

        Parameters
        ----------
        u, v
            (N,) columns and rows, within the grid.
        s, slope_u, slope_v
            (C, N); NaN is seen by no view.
        core, variance
            (H, W) levels, and the variance of their difference from an auxiliary's, levels².
        images, views, buffers
            As in `propagate`.
        gains
            n of (H, W).
        tolerance
            How much nearer than the plane something in a buffer must lie to hide it, units of s.
        """
        ...
