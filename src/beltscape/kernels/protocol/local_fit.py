"""The protocol of the local fit: a plane around every pixel, over a window as large as the data allow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

RADII = ((3, 1.5), (5, 2.5), (8, 4.0))
"""Windows of a local fit: (radius px, Gaussian sigma px)."""
MOST_DISAGREEMENT = 25.0
"""Of two windows: beyond that one of them says nothing about the surface."""


class LocalFit(NamedTuple):
    """The planes; NaN (`scale`: 0) where s was not finite."""

    s: NDArray[np.floating]
    """(H, W) float32, at most 1 from what it was."""
    slope_u: NDArray[np.floating]
    """(H, W) float32, of s per px to the right."""
    slope_v: NDArray[np.floating]
    """(H, W) float32, of s per px downwards."""
    variance: NDArray[np.floating]
    """(H, W) float32, px², of s; infinite where the windows weigh nothing: nothing changes there."""
    disagreement: NDArray[np.floating]
    """(H, W) float32: how far the largest window's value lies off that of the next smaller one, squared, over that
    one's variance, at most `MOST_DISAGREEMENT`: about half of one where the surface is plane; 0 with one window."""
    scale: NDArray[np.uint8]
    """(H, W), which of the radii was taken."""


class Fits(Protocol):
    """Planes by weighted least squares."""

    def local_fit(
        self,
        information: NDArray[np.floating],
        pull: NDArray[np.floating],
        s: NDArray[np.floating],
        slope_u: NDArray[np.floating],
        slope_v: NDArray[np.floating],
        *,
        radii: Sequence[tuple[int, float]] = RADII,
        tolerance: float,
        confidence_width: float = 2.0,
        prior_information: float = 1.0,
        flatten: float = 1.0,
        threads: int = 0,
    ) -> LocalFit:
        """A plane around each pixel p, fitted to s + pull / information of its neighbours q.

        q weighs exp(-|q - p|² / 2σ²) (1 - (e / tolerance)²)₊² (information + prior_information), with
        e = s_q - s_p - slope · (q - p) how far it lies off the plane so far: across a step nothing is smoothed.
        The pull is not helped by the prior, so that a pixel that knows nothing is drawn only to
        its neighbours' s. Taps of the Gaussian below 0.01 are left out. The slopes are held to the earlier
        ones by a ridge of 0.1 px² times the window's weight, which tells only where the window is narrow.

        The variance is that of the weighted mean, each q having 1 / (information + prior_information), and that of
        the plane's tilt from the weights' centre to p.

        Of the windows, the first is taken, and each larger one as long as the confidence intervals
        (value ± confidence_width √variance) of all so far have a value in common.

        With information 1, pull 0, prior 0 and one radius it finds the slopes of a map.

        Parameters
        ----------
        information, pull
            (H, W) from `normal_equations`, 1/px² and 1/px; where one is not finite,
            both count as 0.
        s
            (H, W) nearness; a pixel where it is not finite counts for none.
        slope_u, slope_v
            (H, W) of s per px, of the planes so far; NaN counts as 0.
        radii
            One to four (radius px, Gaussian sigma px), ascending radii of 1 to 15 px.
        tolerance
            Of s in px, 0.001 to 1000.
        confidence_width
            Half the interval's width in standard deviations.
        prior_information
            1/px², what every pixel's present s is trusted with.
        flatten
            0 to 1, which share of e the plane is fitted to, besides pull / information. With 0 the surface keeps
            its own shape, and moves only by what its neighbours' pulls have in common.

        References
        ----------
        Katkovnik, IEEE Trans. Signal Process. 47(9), 2567–2571, 1999, doi:10.1109/78.782208 (intersection of
        confidence intervals); Goldenshluger & Nemirovski, Math. Methods Stat. 6(2), 135–170, 1997.
        """
        ...
