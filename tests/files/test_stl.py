"""Triangle meshes as STL."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.files.stl import read_stl, write_stl

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def test_triangles_come_back_and_normals_point_outside(tmp_path):
    path = tmp_path / "a.stl"
    write_stl(path, VERTICES, FACES)
    corners = read_stl(path)
    np.testing.assert_array_equal(corners, VERTICES[FACES])
    assert path.stat().st_size == 84 + 50 * 4
    assert not path.read_bytes().startswith(b"solid")
    normal = np.frombuffer(path.read_bytes()[84 : 84 + 12], "<f4")
    np.testing.assert_allclose(normal, [0, 0, -1])
    volume = np.sum(corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])) / 6
    assert volume == pytest.approx(1.0)


def test_truncated_file_is_refused(tmp_path):
    path = tmp_path / "a.stl"
    write_stl(path, VERTICES, FACES)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match="no binary STL"):
        read_stl(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_stl(tmp_path / "none.stl")
