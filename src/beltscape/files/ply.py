"""Point clouds as binary little-endian PLY, which CloudCompare and MeshLab open: writing and reading.

σ stands in it twice: as ``sigma``, and as ``scalar_sigma``, because CloudCompare takes a property as a scalar field
by itself only if "scal" is part of its name.
"""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from beltscape.core.cloud import PointCloud
from beltscape.core.errors import InputError
from beltscape.core.frames import Image
from beltscape.files.atomic import atomic_replacement
from beltscape.files.paths import AnyPath, as_path

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


_Number = TypeVar("_Number", np.float32, np.uint8)
_KINDS = {
    "float": "<f4",
    "float32": "<f4",
    "uchar": "u1",
    "uint8": "u1",
    "double": "<f8",
    "int": "<i4",
    "ushort": "<u2",
}
_LONGEST_HEADER = 8192
"""Bytes in which a header must end; headers with all properties of a point have some 500."""
_NO_COLOR = 200
"""Grey level of points without a colour: light, on any background."""


def read_cloud(path: AnyPath) -> PointCloud:
    """Read a binary little-endian PLY of points, with normals, colours and sigma if it has them.

    Raises
    ------
    InputError
        When the file cannot be read or is no such PLY.
    """
    path = as_path(path)
    try:
        with path.open("rb") as file:
            head = file.read(_LONGEST_HEADER)
            end = head.find(b"end_header\n")
            names, kinds, count = _header(path, head[:end] if end >= 0 else b"")
            file.seek(end + len(b"end_header\n"))
            record = np.dtype(list(zip(names, kinds, strict=True)))
            data = file.read(count * record.itemsize)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); give a cloud.ply of reconstruct"
        ) from error
    if len(data) < count * record.itemsize:
        raise InputError(f"{path}: ends before its {count} points do; reconstruct the frame again")
    rows = np.frombuffer(data, record, count)

    def columns(properties: tuple[str, ...], kind: type[_Number], missing: float) -> NDArray[_Number]:
        if not set(properties) <= set(names):
            return np.full((count, len(properties)), missing, kind)
        return np.stack([rows[name].astype(kind) for name in properties], axis=-1)

    return PointCloud(
        points_mm=columns(("x", "y", "z"), np.float32, np.nan),
        normals=columns(("nx", "ny", "nz"), np.float32, np.nan),
        colors=columns(("red", "green", "blue"), np.uint8, _NO_COLOR),
        sigma_mm=columns(("sigma",), np.float32, 0.0)[:, 0],
        frame=_frame(head),
    )


def _header(path: Path, head: bytes) -> tuple[list[str], list[str], int]:
    """Return names and types of a vertex's properties, and the number of vertices."""
    lines = head.decode("ascii", "replace").split("\n")
    if "format binary_little_endian 1.0" not in lines:
        raise InputError(f"{path}: no binary little-endian PLY; give a cloud.ply of reconstruct")
    count, vertex = 0, False
    names: list[str] = []
    kinds: list[str] = []
    for words in (line.split() for line in lines):
        if words[:1] == ["element"]:
            vertex = words[1:2] == ["vertex"]
            count = int(words[2]) if vertex else count
        elif vertex and words[:1] == ["property"] and len(words) == 3 and words[1] in _KINDS:
            kinds.append(_KINDS[words[1]])
            names.append(words[2])
        elif vertex and words[:1] == ["property"]:
            raise InputError(
                f"{path}: a vertex's {words[-1]} is a {words[1]}; only plain numbers can be read"
            )
    if not {"x", "y", "z"} <= set(names):
        raise InputError(f"{path}: its points have no x, y, z; give a cloud.ply of reconstruct")
    return names, kinds, count


def _frame(head: bytes) -> str:
    """Return the coordinate frame in the comment of a cloud of Beltscape; "core" without one."""
    comment = head.partition(b"\ncomment beltscape: frame ")[2].partition(b",")[0]
    return comment.decode("ascii", "replace") or "core"


def image_from_cloud(path: Path, measured: NDArray[np.bool_]) -> Image | None:
    """Return the colours (H, W, 3) uint8 of a frame's cloud on the core's grid, 0 where not measured.

    The cloud must have one point for each measured pixel, row by row; None otherwise, or without a cloud.
    """
    if not path.is_file():
        return None
    colors = read_cloud(path).colors
    if len(colors) != int(measured.sum()):
        return None
    image = np.zeros((*measured.shape, 3), np.uint8)
    image[measured] = colors
    return image
