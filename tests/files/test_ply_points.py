"""Point clouds read from PLY."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.cloud import PointCloud
from beltscape.core.errors import InputError
from beltscape.files.ply import image_from_cloud, read_cloud, write_ply


def cloud(count: int) -> PointCloud:
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(count, 3)).astype(np.float32)
    return PointCloud(
        rng.normal(size=(count, 3)).astype(np.float32),
        normals,
        rng.integers(0, 255, (count, 3)).astype(np.uint8),
        rng.random(count).astype(np.float32),
    )


@pytest.mark.parametrize("count", [0, 1, 1000])
def test_cloud_reads_back_unchanged(tmp_path, count):
    expected = cloud(count)
    write_ply(tmp_path / "cloud.ply", expected)
    back = read_cloud(tmp_path / "cloud.ply")
    for name in ("points_mm", "normals", "colors", "sigma_mm"):
        assert np.array_equal(getattr(back, name), getattr(expected, name))


def test_colours_go_back_to_their_pixels(tmp_path):
    measured = np.random.default_rng(1).random((5, 7)) > 0.4
    expected = cloud(int(measured.sum()))
    write_ply(tmp_path / "cloud.ply", expected)
    image = image_from_cloud(tmp_path / "cloud.ply", measured)
    assert image is not None
    assert np.array_equal(image[measured], expected.colors)
    assert not image[~measured].any()
    assert image_from_cloud(tmp_path / "cloud.ply", ~measured) is None
    assert image_from_cloud(tmp_path / "none.ply", measured) is None


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no binary little-endian PLY"),
        (b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n", "no binary little-endian PLY"),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\nend_header\n",
            "no x, y, z",
        ),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty list uchar int x\nend_header\n",
            "plain",
        ),
    ],
)
def test_other_files_are_refused_in_one_line(tmp_path, content, message):
    path = tmp_path / "cloud.ply"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as error:
        read_cloud(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_truncated_and_missing_files_are_refused_by_name(tmp_path):
    write_ply(tmp_path / "cloud.ply", cloud(10))
    whole = (tmp_path / "cloud.ply").read_bytes()
    (tmp_path / "cut.ply").write_bytes(whole[:-5])
    with pytest.raises(InputError, match="ends before its 10 points"):
        read_cloud(tmp_path / "cut.ply")
    with pytest.raises(InputError, match="cannot be read"):
        read_cloud(tmp_path / "none.ply")
