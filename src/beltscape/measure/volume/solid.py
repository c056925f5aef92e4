"""Triangle meshes of the load as a closed body, and of its upper surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.empty_belt import Belt
from beltscape.measure.volume.load import Range
from beltscape.measure.volume.volume import Volume


@dataclass(frozen=True, slots=True, eq=False)
class SolidMesh:
    """A triangle mesh in the belt frame."""

    vertices_mm: NDArray[np.float64]
    """(N, 3)."""
    faces: NDArray[np.int32]
    """(M, 3) indices, counter-clockwise from outside."""

    @property
    def volume_mm3(self) -> float:
        """Return the volume that a closed mesh encloses (divergence theorem); negative if it is inside out."""
        a, b, c = (self.vertices_mm[self.faces[:, k]] for k in range(3))
        return float(np.sum(a * np.cross(b, c)) / 6)


def build_surface_mesh(volume: Volume) -> SolidMesh:
    """Return the upper surface within the box: load and bare belt, interpolated cells included."""
    x, y, top, _ = _sample_surfaces(volume)
    return SolidMesh(_stack_points(x, y, top), _triangulate_grid(*top.shape))


def build_load_mesh(volume: Volume) -> SolidMesh:
    """Return the load between belt and surface, closed by walls along the box: it encloses the volume."""
    x, y, top, bottom = _sample_surfaces(volume)
    rows, columns = top.shape
    upper = _triangulate_grid(rows, columns)
    lower = upper[:, ::-1] + rows * columns
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    # around the box, counter-clockwise from above
    ring = np.r_[index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]]
    following = np.roll(ring, -1)
    under, under_following = ring + rows * columns, following + rows * columns
    walls = np.concatenate(
        [np.stack([ring, under, following], 1), np.stack([following, under, under_following], 1)]
    )
    vertices = np.concatenate([_stack_points(x, y, top), _stack_points(x, y, bottom)])
    return SolidMesh(vertices, np.concatenate([upper, lower, walls]).astype(np.int32))


def _sample_surfaces(
    volume: Volume,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return x, y of the nodes, and the heights (Ny, Nx) of the surface and of the belt below it."""
    x, y = (
        _select_nodes(*ends)
        for ends in ((volume.load.x_mm, volume.across_mm), (volume.load.y_mm, volume.along_mm))
    )
    load = _interpolate_load(volume, x, y)
    belt: Belt = volume.belt
    bottom = belt.surface_mm(x, y)
    return x, y, bottom + load, np.asarray(bottom, np.float64)


def _select_nodes(centres_mm: NDArray[np.float64], limits_mm: Range) -> NDArray[np.float64]:
    """Return the box's ends and the cells' centres between them."""
    inside = centres_mm[(centres_mm > limits_mm[0] + 1e-6) & (centres_mm < limits_mm[1] - 1e-6)]
    return np.r_[limits_mm[0], inside, limits_mm[1]]


def _interpolate_load(
    volume: Volume, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the load (Ny, Nx) interpolated between its cells' centres, constant beyond the outermost."""
    load = volume.load
    rows = cast("list[NDArray[np.float64]]", list(load.height_mm))
    across = np.array([np.interp(x_mm, load.x_mm, row) for row in rows])
    columns = cast("list[NDArray[np.float64]]", list(across.T))
    return np.array([np.interp(y_mm, load.y_mm, column) for column in columns]).T


def _stack_points(
    x_mm: NDArray[np.float64], y_mm: NDArray[np.float64], z_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    return np.stack([*np.meshgrid(x_mm, y_mm), z_mm], axis=-1).reshape(-1, 3)


def _triangulate_grid(rows: int, columns: int) -> NDArray[np.int32]:
    """Return two triangles for every square of a grid of nodes, counter-clockwise from above."""
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
