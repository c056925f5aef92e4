"""Reading and writing of triangle meshes as binary STL."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.files.atomic import atomic_replacement
from beltscape.files.paths import AnyPath, as_path

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""A facet of a binary STL: 50 bytes."""
_HEAD = 80
"""Bytes before the number of facets in a binary STL."""


def write_stl(path: AnyPath, vertices_mm: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
    """Write vertices (N, 3) in mm and triangles (M, 3), counter-clockwise from outside, atomically."""
    path = as_path(path)
    corners = vertices_mm.astype(np.float32)[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float64)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    facets = np.zeros(len(faces), _FACET)
    facets["normal"] = normal / np.where(length > 0, length, 1.0)
    facets["corners"] = corners
    with atomic_replacement(path) as temporary, temporary.open("wb") as file:
        # a header that begins with the word solid would mark a text file
        file.write(b"binary STL, units mm".ljust(_HEAD, b"\0"))
        file.write(np.uint32(len(faces)).astype("<u4").tobytes())
        file.write(facets.tobytes())


def read_stl(path: AnyPath) -> NDArray[np.float64]:
    """Read the corners (M, 3, 3) of the triangles of a binary STL; InputError with the file's name if it is none."""
    path = as_path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a binary STL") from error
    count = int(np.frombuffer(data[_HEAD : _HEAD + 4], "<u4")[0]) if len(data) >= _HEAD + 4 else -1
    if count < 0 or len(data) != _HEAD + 4 + count * _FACET.itemsize:
        raise InputError(f"{path}: no binary STL; its length does not fit its number of triangles")
    return np.frombuffer(data, _FACET, count, _HEAD + 4)["corners"].astype(np.float64)
