"""Height maps: positions of cells."""

from __future__ import annotations

import numpy as np

from beltscape.core.height_map import HeightMap


def test_cells_are_placed_by_their_centres():
    surface = HeightMap(np.zeros((3, 4)), np.zeros((3, 4)), origin_mm=(-10.0, 5.0), cell_mm=2.5)
    np.testing.assert_array_equal(surface.x_mm, [-10.0, -7.5, -5.0, -2.5])
    np.testing.assert_array_equal(surface.y_mm, [5.0, 7.5, 10.0])
