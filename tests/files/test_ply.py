"""Point clouds written as PLY."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.files.ply import read_cloud, write_ply
from tests.files.clouds import make_cloud

TYPES = {"float": "<f4", "uchar": "u1"}
PROPERTIES = ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "sigma", "scalar_sigma"]


def parsed(data: bytes) -> np.ndarray:
    """The vertices, read by nothing but the header's own words."""
    head, body = data.split(b"end_header\n", 1)
    lines = head.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    words = [line.split() for line in lines]
    (count,) = [int(w[2]) for w in words if w[:2] == ["element", "vertex"]]
    fields = [(w[2], TYPES[w[1]]) for w in words if w[0] == "property"]
    vertices = np.frombuffer(body, np.dtype(fields))
    assert len(vertices) == count
    return vertices


@pytest.mark.parametrize("count", [0, 1, 100])
def test_header_describes_the_vertices(tmp_path, count):
    expected = make_cloud(count)
    write_ply(tmp_path / "cloud.ply", expected)
    vertices = parsed((tmp_path / "cloud.ply").read_bytes())
    assert list(vertices.dtype.names or ()) == PROPERTIES
    np.testing.assert_array_equal(np.stack([vertices[n] for n in "xyz"], -1), expected.points_mm)
    np.testing.assert_array_equal(np.stack([vertices[n] for n in ("nx", "ny", "nz")], -1), expected.normals)
    colors = np.stack([vertices[n] for n in ("red", "green", "blue")], -1)
    np.testing.assert_array_equal(colors, expected.colors)
    for name in ("sigma", "scalar_sigma"):
        np.testing.assert_array_equal(vertices[name], expected.sigma_mm)


def test_cloudcompare_takes_sigma_by_itself(tmp_path):
    """Its reader takes as scalar fields what has "scal" in its name, without that beginning, and intensities."""
    write_ply(tmp_path / "cloud.ply", make_cloud(3))
    names = parsed((tmp_path / "cloud.ply").read_bytes()).dtype.names or ()
    fields = [name.removeprefix("scalar_") for name in names if "scal" in name.lower() or "intensity" in name]
    assert fields == ["sigma"]


@pytest.mark.parametrize("count", [0, 1, 100])
def test_clouds_read_back_unchanged(tmp_path, count):
    expected = make_cloud(count, "belt")
    write_ply(tmp_path / "cloud.ply", expected)
    back = read_cloud(tmp_path / "cloud.ply")
    for key in ("points_mm", "normals", "colors", "sigma_mm"):
        value = getattr(back, key)
        assert value.dtype == getattr(expected, key).dtype
        np.testing.assert_array_equal(value, getattr(expected, key))
    assert back.frame == "belt"


def test_truncated_cloud_is_refused(tmp_path):
    path = tmp_path / "cloud.ply"
    write_ply(path, make_cloud(10))
    other = "no binary little-endian PLY; give a cloud.ply of reconstruct"
    cases = [(path.read_bytes()[:-1], "ends before its 10 points do; reconstruct the frame again")]
    for data, message in [*cases, (b"ply\n", other), (b"", other), (b"\xff" * 50, other)]:
        path.write_bytes(data)
        with pytest.raises(InputError) as error:
            read_cloud(path)
        assert str(error.value) == f"{path}: {message}"


def test_missing_cloud_is_refused_by_name(tmp_path):
    with pytest.raises(InputError) as error:
        read_cloud(tmp_path / "cloud.ply")
    assert (
        str(error.value)
        == f"{tmp_path}/cloud.ply: cannot be read (No such file or directory); give a cloud.ply of reconstruct"
    )
