"""Point clouds written as LAS and LAZ, read back by laspy and, for the coordinate system, by GDAL."""

from __future__ import annotations

import json
import struct
import sys
from dataclasses import replace

import laspy
import numpy as np
import pytest
from laspy.vlrs.known import WktCoordinateSystemVlr
from rasterio.crs import CRS

import beltscape as bs
from beltscape.core.errors import InputError
from beltscape.files.clouds import write_cloud
from beltscape.files.las import RECORD_ID, USER_ID
from tests.files.clouds import make_cloud


@pytest.mark.parametrize("ending", [".las", ".laz", ".LAZ"])
@pytest.mark.parametrize("count", [0, 1, 1000])
def test_a_cloud_reads_back_in_metres(tmp_path, ending, count):
    cloud = make_cloud(count)
    write_cloud(tmp_path / f"cloud{ending}", cloud, {"rig_sha256": "12ab"})
    data = laspy.read(tmp_path / f"cloud{ending}")
    assert data.header.are_points_compressed == (ending != ".las")
    np.testing.assert_allclose(data.xyz * 1000, cloud.points_mm, rtol=0, atol=5.1e-4)  # half of 1 µm
    np.testing.assert_array_equal(np.stack([data.red, data.green, data.blue], -1) // 256, cloud.colors)
    np.testing.assert_array_equal(data.sigma_mm, cloud.sigma_mm)
    np.testing.assert_array_equal(data.confidence, cloud.confidence)
    normals = np.stack([data.NormalX, data.NormalY, data.NormalZ], -1)
    np.testing.assert_array_equal(normals, cloud.normals)
    assert (data.return_number == 1).all() and (data.number_of_returns == 1).all()
    (record,) = [one for one in data.header.vlrs if (one.user_id, one.record_id) == (USER_ID, RECORD_ID)]
    assert json.loads(record.record_data) == {
        "frame": "core", "program": f"beltscape {bs.__version__}", "rig_sha256": "12ab", "units": "m",
    }  # fmt: skip


@pytest.mark.parametrize(("frame", "named"), [("core", "z forward"), ("belt", "z up"), ("plant", "plant")])
def test_the_frame_is_a_local_coordinate_system_in_metres(tmp_path, frame, named):
    write_cloud(tmp_path / "cloud.las", make_cloud(3, frame))
    header = laspy.read(tmp_path / "cloud.las").header
    assert header.global_encoding.wkt
    (text,) = [one.string for one in header.vlrs if isinstance(one, WktCoordinateSystemVlr)]
    system = CRS.from_wkt(text)
    assert named in system.to_wkt() and not system.is_geographic and not system.is_projected
    assert 'UNIT["metre",1]' in system.to_wkt()


def test_bounds_stand_in_the_header_and_no_date(tmp_path):
    cloud = make_cloud(50)
    write_cloud(tmp_path / "cloud.laz", cloud)
    head = (tmp_path / "cloud.laz").read_bytes()[:375]
    assert head[:4] == b"LASF" and head[24:26] == bytes([1, 4])
    assert struct.unpack_from("<HH", head, 90) == (0, 0)
    high_x, low_x = struct.unpack_from("<dd", head, 179)
    assert high_x * 1000 == pytest.approx(cloud.points_mm[:, 0].max(), abs=1e-3)
    assert low_x * 1000 == pytest.approx(cloud.points_mm[:, 0].min(), abs=1e-3)


def test_a_cloud_without_confidence_has_no_such_dimension(tmp_path):
    write_cloud(tmp_path / "cloud.laz", replace(make_cloud(5), confidence=None))
    assert "confidence" not in laspy.read(tmp_path / "cloud.laz").point_format.dimension_names


@pytest.mark.parametrize("value", [np.nan, np.inf, -2.2e6])
def test_points_that_las_cannot_hold_are_refused(tmp_path, value):
    cloud = make_cloud(4)
    cloud.points_mm[2, 1] = value
    with pytest.raises(InputError, match=r"cloud\.las: a point is not finite, or farther than 2147 m"):
        write_cloud(tmp_path / "cloud.las", cloud)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["cloud", "cloud.xyz", "cloud.copc.laz", "laz"])
def test_other_endings_are_refused_by_name(tmp_path, name):
    with pytest.raises(InputError, match=name):
        bs.write_cloud(make_cloud(2), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_write_ply_does_not_write_under_another_formats_name(tmp_path):
    with pytest.raises(InputError, match=r"use bs\.write_cloud"):
        bs.write_ply(make_cloud(2), tmp_path / "cloud.las")
    bs.write_cloud(make_cloud(2), tmp_path / "a.ply")
    bs.write_ply(make_cloud(2), tmp_path / "b.ply")
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


def test_a_missing_library_is_named_with_the_line_to_type(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(InputError, match=r"pip install 'beltscape\[export\]'"):
        bs.write_cloud(make_cloud(2), tmp_path / "cloud.las")
