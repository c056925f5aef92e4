"""Triangle meshes of simple shapes: closed, faces counter-clockwise seen from outside, millimetres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.pose import Pose


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles without a material."""

    vertices_mm: NDArray[np.float64]
    """(V, 3)."""
    faces: NDArray[np.int64]
    """(F, 3) vertex indices, counter-clockwise seen from outside."""

    def transform(self, to_from_mesh: Pose) -> Mesh:
        """Return the mesh in another frame."""
        return Mesh(to_from_mesh.apply(self.vertices_mm), self.faces)

    @property
    def volume_mm3(self) -> float:
        """Return the enclosed volume of a closed mesh, by the divergence theorem: Σ a·(b × c)/6."""
        # relative to the mean vertex: far from the origin the products would lose digits
        a, b, c = np.moveaxis((self.vertices_mm - self.vertices_mm.mean(axis=0))[self.faces], 1, 0)
        return float((a * np.cross(b, c)).sum() / 6)

    @property
    def is_closed(self) -> bool:
        """Return whether every edge occurs once in each direction: closed, and consistently oriented."""
        edges = np.concatenate([self.faces[:, [i, (i + 1) % 3]] for i in range(3)])
        size = int(self.faces.max()) + 1
        forward, backward = edges[:, 0] * size + edges[:, 1], edges[:, 1] * size + edges[:, 0]
        return np.unique(forward).size == forward.size and bool(
            np.array_equal(np.sort(forward), np.sort(backward))
        )


def join_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Return several meshes as one; vertices and faces keep their order."""
    starts = np.cumsum([0, *(len(mesh.vertices_mm) for mesh in meshes[:-1])])
    return Mesh(
        np.concatenate([mesh.vertices_mm for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]),
    )


def make_box(size_mm: Sequence[float]) -> Mesh:
    """Return a cuboid centred on the origin in x and y, standing on z = 0."""
    half_x, half_y, height = size_mm[0] / 2, size_mm[1] / 2, size_mm[2]
    outline = np.array([[-half_x, -half_y], [half_x, -half_y], [half_x, half_y], [-half_x, half_y]])
    vertices = np.concatenate([np.column_stack([outline, np.full(4, z)]) for z in (0.0, height)])
    sides = [[i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4] for i in range(4)]
    return Mesh(vertices, _split(np.array([[3, 2, 1, 0], [4, 5, 6, 7], *sides])))


def make_cylinder(radius_mm: float, height_mm: float, tolerance_mm: float = 0.002) -> Mesh:
    """Return an upright cylinder about the z axis, standing on z = 0.

    It is a regular prism of the exact volume; its side deviates from the round one by at most ``tolerance_mm``.
    """
    count = max(12, int(np.ceil(np.pi / np.arccos(1 - min(tolerance_mm / radius_mm, 0.5)))))
    angle = 2 * np.pi * np.arange(count) / count
    radius = radius_mm * np.sqrt(2 * np.pi / (count * np.sin(2 * np.pi / count)))
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    middle = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, height_mm]])
    vertices = np.concatenate(
        [*(np.column_stack([ring, np.full(count, z)]) for z in (0.0, height_mm)), middle]
    )
    i = np.arange(count)
    j = (i + 1) % count
    bottom = np.column_stack([j, i, np.full(count, 2 * count)])
    top = np.column_stack([i + count, j + count, np.full(count, 2 * count + 1)])
    side = _split(np.column_stack([i, j, j + count, i + count]))
    return Mesh(vertices, np.concatenate([bottom, top, side]))


def make_sphere(radius_mm: float, tolerance_mm: float = 0.002) -> Mesh:
    """Return a sphere about the origin: an icosahedron subdivided until it deviates by at most ``tolerance_mm``.

    It has the exact volume, so that vertices lie slightly outside the sphere and centres of faces slightly inside.
    """
    level = 0
    while (1 - _subdivided_sphere(level)[1]) * radius_mm > tolerance_mm:
        level += 1
    mesh = _subdivided_sphere(level)[0]
    scale = np.cbrt(4 / 3 * np.pi / _subdivided_volume(level))
    return Mesh(mesh.vertices_mm * (radius_mm * scale), mesh.faces)


@cache
def _subdivided_sphere(level: int) -> tuple[Mesh, float]:
    """Return an icosahedron subdivided ``level`` times onto the unit sphere, and its faces' least distance."""
    if level == 0:
        mesh = make_icosahedron()
    else:
        mesh = subdivide(_subdivided_sphere(level - 1)[0])
        mesh = Mesh(mesh.vertices_mm / np.linalg.norm(mesh.vertices_mm, axis=1)[:, None], mesh.faces)
    return mesh, float(np.linalg.norm(mesh.vertices_mm[mesh.faces].mean(axis=1), axis=1).min())


@cache
def _subdivided_volume(level: int) -> float:
    return _subdivided_sphere(level)[0].volume_mm3


def make_icosahedron() -> Mesh:
    """Return a regular icosahedron with its vertices on the unit sphere."""
    golden = (1 + np.sqrt(5)) / 2
    rings = np.array([[0, y, z] for y in (-1.0, 1.0) for z in (-golden, golden)])
    vertices = np.concatenate([np.roll(rings, shift, axis=1) for shift in range(3)])
    distance = np.linalg.norm(vertices[:, None] - vertices[None], axis=-1)
    near = np.abs(distance - 2) < 1e-9
    faces = np.array(
        [
            (a, b, c) if np.linalg.det(vertices[[a, b, c]]) > 0 else (a, c, b)
            for a in range(12)
            for b in range(a + 1, 12)
            for c in range(b + 1, 12)
            if near[a, b] and near[b, c] and near[a, c]
        ]
    )
    return Mesh(vertices / np.hypot(1, golden), faces)


def subdivide(mesh: Mesh) -> Mesh:
    """Split every triangle into four at the middles of its edges; the shape stays the same."""
    edges = np.sort(np.concatenate([mesh.faces[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    count = len(mesh.vertices_mm)
    unique, index = np.unique(edges[:, 0] * count + edges[:, 1], return_inverse=True)
    middles = mesh.vertices_mm[np.stack(np.divmod(unique, count), axis=1)].mean(axis=1)
    ab, bc, ca = (index.reshape(3, -1) + len(mesh.vertices_mm)).astype(np.int64)
    a, b, c = mesh.faces.T
    corners = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return Mesh(
        np.concatenate([mesh.vertices_mm, middles]),
        np.concatenate([np.column_stack(corner) for corner in corners]),
    )


def extrude(outline_mm: NDArray[np.float64], along_mm: NDArray[np.float64]) -> Mesh:
    """Extrude a cross-section of x, z along y into a closed bar.

    Parameters
    ----------
    outline_mm
        (2·K, 2) x, z: K points of the upper side from small to large x, then the K below them, backwards.
    along_mm
        (N,) y of each section, ascending.
    """
    count = len(outline_mm)
    k, n = count // 2, len(along_mm)
    x, z = outline_mm.T
    vertices = np.stack(
        [np.tile(x, n), np.repeat(along_mm, count), np.tile(z, n)],
        axis=-1,
    )
    i = np.arange(count)
    ring = np.column_stack([i, (i + 1) % count, (i + 1) % count + count, i + count])
    sides = (ring[None] + count * np.arange(n - 1)[:, None, None]).reshape(-1, 4)
    strip = np.arange(k - 1)
    front = np.column_stack([strip, count - 1 - strip, count - 2 - strip, strip + 1])
    back = front[:, ::-1] + count * (n - 1)
    return Mesh(vertices, _split(np.concatenate([sides, front, back])))


def triangulate_height_field(
    x_mm: NDArray[np.float64], y_mm: NDArray[np.float64], height_mm: NDArray[np.float64]
) -> Mesh:
    """Triangulate a height map into an open surface with its outside up.

    Parameters
    ----------
    x_mm, y_mm
        (Nx,), (Ny,), ascending.
    height_mm
        (Ny, Nx) z at the nodes; each cell is split from its first to its last corner.
    """
    x, y = np.meshgrid(x_mm, y_mm)
    vertices = np.stack([x.ravel(), y.ravel(), height_mm.ravel()], axis=-1)
    index = np.arange(x.size).reshape(x.shape)
    cells = [index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]]
    return Mesh(vertices, _split(np.stack([c.ravel() for c in cells], axis=-1)))


def _split(quads: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (2·N, 3) triangles of quadrilaterals (N, 4), split from the first to the third corner."""
    return np.stack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
