"""Height maps as TIFF: position, scale and orientation."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
import tifffile

from beltscape.core.errors import InputError
from beltscape.core.height_map import HeightMap
from beltscape.files.tiff import read_height_tiff, write_float_tiff, write_height_tiff

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
        assert tags[33550].value == (0.0025, 0.0025, 0.0)
        assert tags[33922].value == pytest.approx((0.0, 0.0, 0.0, -8.25e-3, 26.25e-3, 0.0))
        assert tags[42113].value == "nan"
        values = file.pages.first.asarray()
    assert values.dtype == np.float32
    np.testing.assert_array_equal(values[0], (0.1 * HEIGHT[2]).astype(np.float32))


@pytest.mark.parametrize(("sigma", "description"), [(False, "height over"), (True, "standard deviation")])
def test_gdal_finds_a_local_system_in_metres_and_heights_in_mm(tmp_path, sigma, description):
    write_height_tiff(tmp_path / "load.tiff", MAP, sigma=sigma)
    with rasterio.open(tmp_path / "load.tiff") as file:
        system = file.crs.to_wkt()
        assert system.startswith('LOCAL_CS["Beltscape belt frame (x across, y along, z up)"')
        assert 'UNIT["metre",1' in system
        assert not file.crs.is_geographic and not file.crs.is_projected
        assert file.bounds == pytest.approx((-8.25e-3, 18.75e-3, 1.75e-3, 26.25e-3))
        assert file.units == ("mm",) and file.descriptions[0].startswith(description)  # pyrefly: ignore[missing-attribute]
        assert np.isnan(file.nodata) and file.tags()["AREA_OR_POINT"] == "Area"  # pyrefly: ignore[no-matching-overload]
        values = file.read(1, masked=True)
        assert values.mask.sum() == np.isnan(HEIGHT).sum()  # pyrefly: ignore[missing-attribute]
        # the cell at the map's centre of row 2, column 1 is found by its position in metres
        row, column = file.index(-7.0e-3 + 2.5e-3, 20.0e-3 + 2 * 2.5e-3)
        expected = (0.1 if sigma else 1.0) * HEIGHT[2, 1]
        assert values[row, column] == pytest.approx(expected, rel=1e-6)


def test_a_map_of_earlier_versions_in_millimetres_is_read(tmp_path):
    keys = (1, 1, 1, 2, 1024, 0, 1, 32767, 1025, 0, 1, 1)
    tags = [(33550, 12, 3, (2.5, 2.5, 0.0), True), (33922, 12, 6, (0.0, 0.0, 0.0, -8.25, 26.25, 0.0), True)]
    tifffile.imwrite(
        tmp_path / "load.tiff",
        HEIGHT[::-1].astype(np.float32),
        photometric="minisblack",
        metadata=None,
        extratags=[*tags, (34735, 3, len(keys), keys, True)],
    )
    back = read_height_tiff(tmp_path / "load.tiff")
    np.testing.assert_array_equal(back.height_mm, HEIGHT)
    assert (back.origin_mm, back.cell_mm) == (MAP.origin_mm, MAP.cell_mm)


def test_a_map_without_a_scale_is_refused(tmp_path):
    write_float_tiff(tmp_path / "depth.tiff", HEIGHT.astype(np.float32))
    with pytest.raises(InputError, match="no height map with a scale"):
        read_height_tiff(tmp_path / "depth.tiff")
