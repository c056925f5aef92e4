"""Height maps as TIFF: position, scale and orientation."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile

from beltscape.core.belt.height_map import HeightMap
from beltscape.core.errors import InputError
from beltscape.files.rasters.depth_tiff import write_float_tiff
from beltscape.files.rasters.height_tiff import read_height_tiff, write_height_tiff

HEIGHT = np.arange(12.0).reshape(3, 4)
HEIGHT[1, 2] = np.nan
MAP = HeightMap(HEIGHT, 0.1 * HEIGHT, (-7.0, 20.0), 2.5)


def test_height_map_reads_back_at_its_position(tmp_path):
    write_height_tiff(tmp_path / "load.tiff", MAP)
    back = read_height_tiff(tmp_path / "load.tiff")
    np.testing.assert_array_equal(back.height_mm, HEIGHT)
    assert back.origin_mm == pytest.approx(MAP.origin_mm)
    assert back.cell_mm == MAP.cell_mm


def test_its_tags_place_the_upper_left_corner_and_y_points_up(tmp_path):
    write_height_tiff(tmp_path / "load.tiff", MAP, sigma=True)
    with tifffile.TiffFile(tmp_path / "load.tiff") as file:
        tags = file.pages.first.tags
        assert tags[33550].value == (2.5, 2.5, 0.0)
        assert tags[33922].value == (0.0, 0.0, 0.0, -8.25, 26.25, 0.0)
        assert tags[42113].value == "nan"
        values = file.pages.first.asarray()
    assert values.dtype == np.float32
    np.testing.assert_array_equal(values[0], (0.1 * HEIGHT[2]).astype(np.float32))


def test_a_map_without_a_scale_is_refused(tmp_path):
    write_float_tiff(tmp_path / "depth.tiff", HEIGHT.astype(np.float32))
    with pytest.raises(InputError, match="no height map with a scale"):
        read_height_tiff(tmp_path / "depth.tiff")
