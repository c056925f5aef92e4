"""Depth as TIFF: exact round trip, other readers, damaged files."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import tifffile

from beltscape.core.errors import InputError
from beltscape.files.tiff import read_float_tiff, write_float_tiff


def depth() -> np.ndarray:
    values = np.random.default_rng(2).uniform(500, 1500, (23, 31)).astype(np.float32)
    values[3:9, 4:20] = np.nan
    return values


@pytest.mark.parametrize("compressed", [False, True])
def test_depth_with_unmeasured_pixels_reads_back(tmp_path, compressed):
    write_float_tiff(tmp_path / "depth.tiff", depth(), compressed=compressed)
    back = read_float_tiff(tmp_path / "depth.tiff")
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, depth())
    assert [p.name for p in tmp_path.iterdir()] == ["depth.tiff"]


def test_opencv_reads_the_same_depth(tmp_path):
    write_float_tiff(tmp_path / "depth.tiff", depth())
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "depth.tiff"), cv2.IMREAD_UNCHANGED), depth())


def test_the_same_depth_gives_the_same_bytes(tmp_path):
    for name in ("a.tiff", "b.tiff"):
        write_float_tiff(tmp_path / name, depth())
    assert (tmp_path / "a.tiff").read_bytes() == (tmp_path / "b.tiff").read_bytes()


def test_integers_and_several_planes_are_refused(tmp_path):
    tifffile.imwrite(tmp_path / "a.tiff", np.zeros((4, 5), np.uint16))
    tifffile.imwrite(tmp_path / "b.tiff", np.zeros((2, 4, 5), np.float32), photometric="minisblack")
    with pytest.raises(InputError) as integers:
        read_float_tiff(tmp_path / "a.tiff")
    with pytest.raises(InputError) as planes:
        read_float_tiff(tmp_path / "b.tiff")
    assert (
        str(integers.value) == f"{tmp_path}/a.tiff: holds uint16 of shape (4, 5); one float32 plane is needed"
    )
    assert str(planes.value) == (
        f"{tmp_path}/b.tiff: holds float32 of shape (2, 4, 5); one float32 plane is needed"
    )


def test_missing_and_damaged_files_are_named(tmp_path):
    path = tmp_path / "depth.tiff"
    with pytest.raises(InputError) as missing:
        read_float_tiff(path)
    assert str(missing.value) == f"{path}: no such file; give a frame folder of beltscape reconstruct"
    path.write_bytes(b"not a tiff at all")
    with pytest.raises(InputError, match=rf"^{path}: not a readable TIFF \(.*\)$"):
        read_float_tiff(path)


def test_a_truncated_depth_is_refused(tmp_path):
    path = tmp_path / "depth.tiff"
    write_float_tiff(path, depth())
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(InputError, match=rf"^{path}: not a readable TIFF \(.*\)$"):
        read_float_tiff(path)
