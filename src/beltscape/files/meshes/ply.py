"""cloud.ply: binary little-endian PLY that CloudCompare and MeshLab open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.cloud import PointCloud
from beltscape.core.errors import InputError
from beltscape.files.folders.atomic import replacing
from beltscape.files.folders.paths import AnyPath, as_path

_VERTEX = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    + [(name, "u1") for name in ("red", "green", "blue")]
    + [("sigma", "<f4")]
)
_PACKED = np.dtype([("point", "V12"), ("normal", "V12"), ("color", "V3"), ("sigma", "<f4")])
"""The same 31 bytes, copied in four pieces instead of ten."""
_BLOCK = 1 << 16
"""Vertices put together at a time: they stay in the cache, and the file's content is never held twice."""
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
end_header
"""


def write_cloud(path: AnyPath, cloud: PointCloud) -> None:
    """Write a cloud, atomically."""
    path = as_path(path)
    count = len(cloud.points_mm)
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(_HEADER.format(frame=cloud.frame, count=count).encode("ascii"))
        block = np.empty(min(count, _BLOCK), _PACKED)
        for first in range(0, count, _BLOCK):
            some = slice(first, first + _BLOCK)
            part = block[: count - first]
            part["point"] = _items(cloud.points_mm[some], "<f4")
            part["normal"] = _items(cloud.normals[some], "<f4")
            part["color"] = _items(cloud.colors[some], "u1")
            part["sigma"] = cloud.sigma_mm[some]
            file.write(part.data)


def _items(rows: NDArray[np.generic], dtype: str) -> NDArray[np.void]:
    """(n,) view of (n, 3) rows as one item each, which NumPy copies several times faster than three numbers."""
    packed = np.ascontiguousarray(rows, dtype)
    return packed.view((np.void, 3 * packed.itemsize))[:, 0]


def read_cloud(path: Path) -> PointCloud:
    """Read a cloud that `write_cloud` wrote, or InputError."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    head, marker, body = data.partition(b"end_header\n")
    lines = head.decode("ascii", "replace").splitlines()
    counts = [line.split()[2] for line in lines if line.startswith("element vertex ")]
    frames = [line.split("frame ")[1].split(",")[0] for line in lines if line.startswith("comment beltscape")]
    count = int(counts[0]) if counts else -1
    if not marker or not frames or len(body) != count * _VERTEX.itemsize:
        raise InputError(f"{path}: not a cloud of beltscape reconstruct, or cut short")
    vertices = np.frombuffer(body, _VERTEX)
    return PointCloud(
        points_mm=np.stack([vertices[name] for name in "xyz"], axis=-1),
        normals=np.stack([vertices[name] for name in ("nx", "ny", "nz")], axis=-1),
        colors=np.stack([vertices[name] for name in ("red", "green", "blue")], axis=-1),
        sigma_mm=vertices["sigma"].copy(),
        frame=frames[0],
    )
