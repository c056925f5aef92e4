"""Writing of point clouds as binary little-endian PLY, which CloudCompare and MeshLab open.

σ stands in it twice: as ``sigma``, and as ``scalar_sigma``, because CloudCompare takes a property as a scalar field
by itself only if "scal" is part of its name.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.cloud import PointCloud
from beltscape.files.folders.atomic import atomic_replacement
from beltscape.files.folders.paths import AnyPath, as_path

_PACKED = np.dtype([("point", "V12"), ("normal", "V12"), ("color", "V3"), ("sigma", "<f4", 2)])
"""A vertex as four items instead of ten numbers, which NumPy copies faster."""
_BLOCK = 1 << 16
"""Vertices written at a time: they fit in the cache, and the file's content is never in memory twice."""
_HEADER = """ply
format binary_little_endian 1.0
comment beltscape: frame {frame}, millimetres
element vertex {count}
property float x
property float y
property float z
property float nx
property float ny
property float nz
property uchar red
property uchar green
property uchar blue
property float sigma
property float scalar_sigma
end_header
"""


def write_ply(path: AnyPath, cloud: PointCloud) -> None:
    """Write a cloud, atomically."""
    path = as_path(path)
    count = len(cloud.points_mm)
    with atomic_replacement(path) as temporary, temporary.open("wb") as file:
        file.write(_HEADER.format(frame=cloud.frame, count=count).encode("ascii"))
        block = np.empty(min(count, _BLOCK), _PACKED)
        for first in range(0, count, _BLOCK):
            some = slice(first, first + _BLOCK)
            part = block[: count - first]
            part["point"] = _items(cloud.points_mm[some], "<f4")
            part["normal"] = _items(cloud.normals[some], "<f4")
            part["color"] = _items(cloud.colors[some], "u1")
            part["sigma"] = cloud.sigma_mm[some, None]
            file.write(part.data)


def _items(rows: NDArray[np.generic], dtype: str) -> NDArray[np.void]:
    """Return a view (n,) of rows (n, 3) as one item each, which NumPy copies several times faster."""
    packed = np.ascontiguousarray(rows, dtype)
    return packed.view((np.void, 3 * packed.itemsize))[:, 0]
