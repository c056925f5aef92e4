"""Prior of any lens: it keeps parameters plausible that the images do not determine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera

Array = NDArray[np.float64]

ASPECT_SIGMA = 0.005
"""Standard deviation of fx - fy over their mean."""
CENTER_SIGMA = 0.03
"""Standard deviation of the principal point about the image's centre, over the image's width."""
DISTORTION_SIGMA = np.array([0.5, 0.7, 0.005, 0.005, 0.7])
"""Standard deviations of k1, k2, p1, p2, k3 about 0."""


def pack_intrinsics(camera: Camera) -> Array:
    """Return the intrinsics (9,) fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    return np.array([*camera.focal_px, *camera.center_px, *camera.distortion])


def compute_lens_prior(camera: Camera) -> tuple[Array, Array]:
    """Return mean (9,) and information (9, 9) of a lens's parameters; the focal length itself has no prior.

    The prior is a hundred times wider than the estimate from a good set of views, so it matters only without them.
    """
    width, height = camera.size_px
    focal = float(camera.focal_px.mean())
    mean = np.array([focal, focal, (width - 1) / 2, (height - 1) / 2, *np.zeros(5)])
    information = np.zeros((9, 9))
    information[:2, :2] = np.array([[1.0, -1.0], [-1.0, 1.0]]) / (ASPECT_SIGMA * focal) ** 2
    information[[2, 3], [2, 3]] = 1 / (CENTER_SIGMA * width) ** 2
    information[range(4, 9), range(4, 9)] = DISTORTION_SIGMA**-2.0
    return mean, information
