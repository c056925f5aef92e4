"""Packed projections: one row of numbers per auxiliary, as native/view.hpp and native/lens.hpp lay them out.

A row holds the direction matrix (9, row by row), the shift (3), focal lengths (2) and principal point (2), then the
lens: k1, k2, p1, p2, k3, the squared radius of its domain, the code of its model, k4, k5, k6, s1 to s4, and the
homography of the tilted sensor (9, row by row).
"""

from __future__ import annotations

import numpy as np

from beltscape.core.arrays import Array
from beltscape.core.geometry import tilt

PROJECTION_SIZE = 39
"""Numbers of a packed projection."""
LENS = slice(16, PROJECTION_SIZE)
"""Those of the lens."""
CODES = {"brown": 0.0, "rational": 1.0, "thin_prism": 1.0, "tilted": 2.0, "fisheye": 3.0}
"""Codes of the lens models in a row; a thin prism of zeros is the rational model."""


def pack_lens(model: str, coefficients: Array, valid_radius: float = np.inf) -> Array:
    """Return the lens (23,) of a packed projection.

    ``coefficients`` are those of the model, ``valid_radius`` is the domain's in undistorted image-plane coordinates.
    """
    row = np.zeros(23)
    row[5], row[6] = valid_radius**2, CODES[model]
    if model == "fisheye":
        row[[0, 1, 4, 7]] = coefficients
        return row
    row[:5], row[7:14][: len(coefficients[5:12])] = coefficients[:5], coefficients[5:12]
    if model == "tilted":
        row[14:] = tilt.compute_homography(*coefficients[12:]).ravel()
    return row
