"""Exact ray casting: Embree finds the triangle in float32, float64 computes the intersection.

Embree's hit is accurate to about 1e-4 mm. The triangle hit, its neighbours, and any surface within a hundredth of a
millimetre behind the hit are therefore intersected again in float64 (Möller and Trumbore,
doi:10.1080/10867651.1997.10487468), and the nearest is taken: distances are exact to less than 1e-6 mm. Two cases
remain: a ray that passes the outline of a solid by less than Embree's error may miss it, and of two surfaces closer
to each other than that error the farther one may be returned.

Hits have the reflectance of the surface there, textures included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.simulate.world import Solid

_WINDOW_MM = 0.01
"""Surfaces this close behind each other are ordered in float64."""
_OFFSET_MM = 0.005
"""Distance by which a surface point is moved outward before a test of its visibility."""
_EDGE_TOLERANCE = 1e-9
"""Tolerance of the barycentric coordinates, so that no ray passes between two adjacent triangles."""
_BLOCK = 1 << 16
"""Rays traced at once, which bounds the memory; four times as many leave the cache and take a quarter more time."""
_PASSES = 4
"""Surfaces of one label that a ray may pass."""


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """The first intersections of rays."""

    distance: NDArray[np.float64]
    """(N,) in lengths of the ray's direction; inf where it hits nothing."""
    face: NDArray[np.int64]
    """(N,) index into `RayScene.corners_mm`; -1 where the ray hits nothing."""


class RayScene:
    """Solids prepared for ray casting."""

    corners_mm: NDArray[np.float64]
    """(F, 3, 3) of all solids' faces, one solid after the other."""
    solid_of_face: NDArray[np.int64]
    """(F,) index of the solid of each face."""
    label_of_face: NDArray[np.uint8]
    """(F,) label of each face."""

    def __init__(self, solids: Sequence[Solid]) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        counts = [len(solid.faces) for solid in solids]
        starts = np.cumsum([0, *(len(solid.vertices_mm) for solid in solids)])[:-1]
        vertices = np.concatenate([solid.vertices_mm for solid in solids])
        self._faces = np.concatenate([s.faces + start for s, start in zip(solids, starts, strict=True)])
        self.first_face = np.cumsum([0, *counts])[:-1]
        self.corners_mm = vertices[self._faces]
        self.solid_of_face = np.repeat(np.arange(len(solids)), counts)
        self.label_of_face = np.repeat(np.array([s.label for s in solids], np.uint8), counts)
        self._vertex_count = len(vertices)
        self._embree: Any = EmbreeScene()
        TriangleMesh(self._embree, vertices.astype(np.float32), self._faces.astype(np.int32))

    @cached_property
    def _by_vertex(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Faces by their vertices, and (V + 1,) where each vertex's faces begin; few rays need them."""
        order = np.argsort(self._faces.ravel(), kind="stable")
        return order // 3, np.searchsorted(self._faces.ravel()[order], np.arange(self._vertex_count + 1))

    def cast(self, origins_mm: NDArray[np.float64], directions: NDArray[np.float64]) -> Hits:
        """Return the first hits of rays from (N, 3) or (3,) along (N, 3); a ray with NaN hits nothing."""
        origins = np.broadcast_to(origins_mm, directions.shape)
        distance = np.full(len(directions), np.inf)
        face = np.full(len(directions), -1)
        for start in range(0, len(directions), _BLOCK):
            block = np.arange(start, min(start + _BLOCK, len(directions)))
            block = block[np.isfinite(directions[block]).all(axis=1)]
            distance[block], face[block] = self._cast_block(origins[block], directions[block])
        return Hits(distance, face)

    def is_free(self, origins_mm: NDArray[np.float64], ends_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return (N,) whether nothing lies between points (N, 3) and points (N, 3) or (3,)."""
        is_free = np.zeros(len(origins_mm), bool)
        ends = np.broadcast_to(ends_mm, origins_mm.shape)
        for start in range(0, len(is_free), _BLOCK):
            block = slice(start, start + _BLOCK)
            directions = (ends[block] - origins_mm[block]).astype(np.float32)
            limit = np.ones(len(directions), np.float32)
            is_free[block] = (
                self._embree.run(
                    origins_mm[block].astype(np.float32), directions, dists=limit, query="OCCLUDED"
                )
                < 0
            )
        return is_free

    def face_normals(self, faces: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return (N, 3) unit outward normals of faces (N,); NaN for -1."""
        repeated = len(faces) > len(self.corners_mm)  # then each face's normal is computed once
        a, b, c = np.moveaxis(self.corners_mm if repeated else self.corners_mm[faces], 1, 0)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        return np.where(faces[:, None] >= 0, normal[faces] if repeated else normal, np.nan)

    def is_visible_from(
        self, points_mm: NDArray[np.float64], normals: NDArray[np.float64], eye_mm: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Return (N,) whether surface points (N, 3) with outward normals (N, 3) are visible from an eye (3,)."""
        is_visible = ((eye_mm - points_mm) * normals).sum(axis=1) > 0
        is_visible[is_visible] = self.is_free(
            points_mm[is_visible] + _OFFSET_MM * normals[is_visible], eye_mm
        )
        return is_visible

    def _cast_block(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64], passes: int = _PASSES
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return distances and faces; a ray that misses its face in float64 is cast again from behind that face."""
        embree_distance, face = self._cast_embree(origins, directions)
        distance = np.full(len(origins), np.inf)
        hit = np.flatnonzero(face >= 0)
        points, hit_directions = origins[hit] + embree_distance[hit, None] * directions[hit], directions[hit]
        step, inside = _intersect(points, hit_directions, self.corners_mm[face[hit]])
        distance[hit] = np.where(inside, embree_distance[hit] + step, np.inf)
        # cast back from just behind the hit: it finds another face where two surfaces are close to each other
        window = _WINDOW_MM / np.linalg.norm(hit_directions, axis=1)
        _, second = self._cast_embree(points + window[:, None] * hit_directions, -hit_directions, 2 * window)
        other = np.flatnonzero((second >= 0) & (second != face[hit]) & inside)
        step, is_hit = _intersect(points[other], hit_directions[other], self.corners_mm[second[other]])
        rays, nearer = hit[other], embree_distance[hit[other]] + step
        is_nearer = is_hit & (nearer < distance[rays])
        distance[rays[is_nearer]], face[rays[is_nearer]] = nearer[is_nearer], second[other][is_nearer]
        for i in np.flatnonzero(~inside):
            ray = hit[i]
            step_near, face[ray] = self._intersect_near(
                points[i], hit_directions[i], (int(face[ray]), int(second[i]))
            )
            distance[ray] = embree_distance[ray] + step_near
        missed = hit[~np.isfinite(distance[hit])]
        if missed.size and passes:
            window = _WINDOW_MM / np.linalg.norm(directions[missed], axis=1)
            ahead = embree_distance[missed] + window
            restart = origins[missed] + ahead[:, None] * directions[missed]
            remaining, face[missed] = self._cast_block(restart, directions[missed], passes - 1)
            distance[missed] = ahead + remaining
        return distance, face

    def _cast_embree(
        self,
        origins: NDArray[np.float64],
        directions: NDArray[np.float64],
        limit: NDArray[np.float64] | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return Embree's distances and faces."""
        limits = None if limit is None else limit.astype(np.float32)
        hits = self._embree.run(
            origins.astype(np.float32), directions.astype(np.float32), dists=limits, output=True
        )
        return hits["tfar"].astype(np.float64), hits["primID"].astype(np.int64)

    def _intersect_near(
        self, at: NDArray[np.float64], along: NDArray[np.float64], faces: Sequence[int]
    ) -> tuple[float, int]:
        """Return step and face of the first intersection with faces and their neighbours; (inf, -1): none."""
        candidates = np.unique(
            np.concatenate([self._neighbouring_faces(face) for face in faces if face >= 0])
        )
        shape = (len(candidates), 3)
        step, is_hit = _intersect(
            np.broadcast_to(at, shape), np.broadcast_to(along, shape), self.corners_mm[candidates]
        )
        # an intersection farther away lies on another part of a large neighbour and is left to the next cast
        is_hit &= np.abs(step) * np.linalg.norm(along) < _WINDOW_MM
        if not is_hit.any():
            return np.inf, -1
        first = int(np.argmin(np.where(is_hit, step, np.inf)))
        return float(step[first]), int(candidates[first])

    def _neighbouring_faces(self, face: int) -> NDArray[np.int64]:
        """Return the faces that share a vertex with a face, including itself."""
        faces, first = self._by_vertex
        spans = [slice(*first[vertex : vertex + 2]) for vertex in self._faces[face]]
        return np.concatenate([faces[span] for span in spans])


def _intersect(
    origins: NDArray[np.float64], directions: NDArray[np.float64], corners: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return (N,) steps along (N, 3) to the planes of triangles (N, 3, 3), and (N,) whether the points lie within."""
    a, b, c = np.ascontiguousarray(corners.transpose(1, 2, 0))
    along = np.ascontiguousarray(directions.T)
    ab, ac = b - a, c - a
    normal_of_ray = _cross(along, ac)
    with np.errstate(divide="ignore", invalid="ignore"):  # for a ray parallel to a face NaN counts as outside
        scale = 1 / _dot(ab, normal_of_ray)
        from_a = origins.T - a
        u = _dot(from_a, normal_of_ray) * scale
        normal_of_ab = _cross(from_a, ab)
        v = _dot(along, normal_of_ab) * scale
        return _dot(ac, normal_of_ab) * scale, (u >= -_EDGE_TOLERANCE) & (v >= -_EDGE_TOLERANCE) & (
            u + v <= 1 + _EDGE_TOLERANCE
        )


def _dot(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the scalar products (N,) of vectors (3, N); sums by row are several times as fast as by column."""
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


def _cross(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the vector products (3, N) of vectors (3, N)."""
    (ax, ay, az), (bx, by, bz) = first, second
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def reflectance_at(
    scene: RayScene, solids: Sequence[Solid], face: NDArray[np.int64], points_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (N,) diffuse reflectance, mean of the colours, at points (N, 3) on faces (N,); 0 for face -1."""
    values = np.zeros(len(face))
    solid_of = np.where(face >= 0, scene.solid_of_face[face], -1)
    for index, solid in enumerate(solids):
        of_solid = np.flatnonzero(solid_of == index)
        if not of_solid.size:
            continue
        if solid.texture is None or solid.uv is None:
            values[of_solid] = np.mean(solid.reflectance)
        else:
            corners = solid.uv[solid.faces[face[of_solid] - scene.first_face[index]]]
            uv = np.einsum(
                "nk,nki->ni", _barycentric(scene.corners_mm[face[of_solid]], points_mm[of_solid]), corners
            )
            values[of_solid] = _texels(solid.texture * np.array(solid.reflectance, np.float32), uv)
    return values


def _barycentric(corners: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N, 3) barycentric coordinates of points (N, 3) in the planes of triangles (N, 3, 3)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    area = np.maximum((normal**2).sum(axis=1), 1e-30)
    of_b = (np.cross(points - a, c - a) * normal).sum(axis=1) / area
    of_c = (np.cross(b - a, points - a) * normal).sum(axis=1) / area
    return np.column_stack([1 - of_b - of_c, of_b, of_c])


def _texels(texture: NDArray[np.float32], uv: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N,) nearest texels, mean of their colours."""
    height, width = texture.shape[:2]
    column = (uv[:, 0] * width).astype(int).clip(0, width - 1)
    row = (uv[:, 1] * height).astype(int).clip(0, height - 1)
    return texture[row, column].mean(axis=-1).astype(np.float64)
