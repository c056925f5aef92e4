"""What is known of any lens beforehand: enough to keep a parameter sane that the images do not determine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera

Array = NDArray[np.float64]

ASPECT_SIGMA = 0.005
"""fx and fy differ by so much, over their mean."""
CENTER_SIGMA = 0.03
"""The principal point is so far from the image's centre, over its width."""
DISTORTION_SIGMA = np.array([0.5, 0.7, 0.005, 0.005, 0.7])
"""k1, k2, p1, p2, k3 about 0."""


def pack_intrinsics(camera: Camera) -> Array:
    """(9,) fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    return np.array([*camera.focal_px, *camera.center_px, *camera.distortion])


def compute_lens_prior(camera: Camera) -> tuple[Array, Array]:
    """Mean (9,) and information (9, 9) of a lens's parameters; nothing is said about the focal length itself.

    A hundred times wider than what a good set of views tells, so that it decides only where they say nothing.
    """
    width, height = camera.size_px
    focal = float(camera.focal_px.mean())
    mean = np.array([focal, focal, (width - 1) / 2, (height - 1) / 2, *np.zeros(5)])
    information = np.zeros((9, 9))
    information[:2, :2] = np.array([[1.0, -1.0], [-1.0, 1.0]]) / (ASPECT_SIGMA * focal) ** 2
    information[[2, 3], [2, 3]] = 1 / (CENTER_SIGMA * width) ** 2
    information[range(4, 9), range(4, 9)] = DISTORTION_SIGMA**-2.0
    return mean, information
