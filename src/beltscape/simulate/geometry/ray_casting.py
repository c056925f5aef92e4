"""Exact ray casting: Embree finds the triangle in float32, float64 says where the ray meets it.

Embree's answer is right to some 1e-4 mm. What a ray meets within a hundredth of a millimetre, and the triangles
around it, are therefore intersected once more in float64 (Möller and Trumbore, doi:10.1080/10867651.1997.10487468)
and the nearest is taken: distances are exact to less than 1e-6 mm. What stays are two cases: a ray that passes the
outline of a solid by less than Embree's own error may miss it, and of two surfaces nearer to each other than that
error the farther may be named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.simulate.geometry.world import Solid

_WINDOW_MM = 0.01
"""Surfaces as near as this behind each other are told apart in float64."""
_OFFSET_MM = 0.005
"""How far before its surface a point is when one asks what it sees."""
_EDGE_TOLERANCE = 1e-9
"""Barycentric coordinate down to which a ray meets a triangle: none slips between two."""
_BLOCK = 1 << 18
_PASSES = 4


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """What rays meet first."""

    distance: NDArray[np.float64]
    """(N,) in lengths of the ray's direction; inf where it meets nothing."""
    face: NDArray[np.int64]
    """(N,) index into `RayScene.corners_mm`; -1 where it meets nothing."""


class RayScene:
    """Solids that rays can be sent at."""

    corners_mm: NDArray[np.float64]
    """(F, 3, 3) of all solids' faces, one solid after the other."""
    solid_of_face: NDArray[np.int64]
    """(F,) index of the solid; -1 in, -1 out."""
    label_of_face: NDArray[np.uint8]
    """(F,) its label."""

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
        order = np.argsort(self._faces.ravel(), kind="stable")
        self._faces_by_vertex = order // 3
        self._first_by_vertex = np.searchsorted(self._faces.ravel()[order], np.arange(len(vertices) + 1))
        self._embree: Any = EmbreeScene()
        TriangleMesh(self._embree, vertices.astype(np.float32), self._faces.astype(np.int32))

    def cast(self, origins_mm: NDArray[np.float64], directions: NDArray[np.float64]) -> Hits:
        """First hits of rays from (N, 3) or (3,) along (N, 3); a ray with NaN in it meets nothing."""
        origins = np.broadcast_to(origins_mm, directions.shape)
        distance = np.full(len(directions), np.inf)
        face = np.full(len(directions), -1)
        for start in range(0, len(directions), _BLOCK):
            block = np.arange(start, min(start + _BLOCK, len(directions)))
            block = block[np.isfinite(directions[block]).all(axis=1)]
            distance[block], face[block] = self._cast_block(origins[block], directions[block])
        return Hits(distance, face)

    def is_free(self, origins_mm: NDArray[np.float64], ends_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(N,) whether nothing stands between points (N, 3) and points (N, 3) or (3,)."""
        free = np.zeros(len(origins_mm), bool)
        ends = np.broadcast_to(ends_mm, origins_mm.shape)
        for start in range(0, len(free), _BLOCK):
            block = slice(start, start + _BLOCK)
            way = (ends[block] - origins_mm[block]).astype(np.float32)
            limit = np.ones(len(way), np.float32)
            free[block] = (
                self._embree.run(origins_mm[block].astype(np.float32), way, dists=limit, query="OCCLUDED") < 0
            )
        return free

    def face_normals(self, faces: NDArray[np.int64]) -> NDArray[np.float64]:
        """(N, 3) unit normals, outward, of faces (N,); NaN for -1."""
        a, b, c = np.moveaxis(self.corners_mm[faces], 1, 0)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        return np.where(faces[:, None] >= 0, normal, np.nan)

    def is_visible_from(
        self, points_mm: NDArray[np.float64], normals: NDArray[np.float64], eye_mm: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """(N,) whether surface points (N, 3) with outward normals (N, 3) face the eye (3,) and it sees them."""
        facing = ((eye_mm - points_mm) * normals).sum(axis=1) > 0
        facing[facing] = self.is_free(points_mm[facing] + _OFFSET_MM * normals[facing], eye_mm)
        return facing

    def _cast_block(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64], passes: int = _PASSES
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Distances and faces; rays that float64 finds to pass the face beside are sent on behind it."""
        rough, face = self._cast_embree(origins, directions)
        distance = np.full(len(origins), np.inf)
        there = np.flatnonzero(face >= 0)
        at, along = origins[there] + rough[there, None] * directions[there], directions[there]
        step, inside = _intersect(at, along, self.corners_mm[face[there]])
        distance[there] = np.where(inside, rough[there] + step, np.inf)
        # from just behind the hit, back: another face is met first where two surfaces are near each other
        window = _WINDOW_MM / np.linalg.norm(along, axis=1)
        _, second = self._cast_embree(at + window[:, None] * along, -along, 2 * window)
        other = np.flatnonzero((second >= 0) & (second != face[there]) & inside)
        step, met = _intersect(at[other], along[other], self.corners_mm[second[other]])
        rays, nearer = there[other], rough[there[other]] + step
        better = met & (nearer < distance[rays])
        distance[rays[better]], face[rays[better]] = nearer[better], second[other][better]
        for i in np.flatnonzero(~inside):
            ray = there[i]
            near, face[ray] = self._intersect_near(at[i], along[i], (face[ray], second[i]))
            distance[ray] = rough[ray] + near
        lost = there[~np.isfinite(distance[there])]
        if lost.size and passes:
            window = _WINDOW_MM / np.linalg.norm(directions[lost], axis=1)
            ahead = rough[lost] + window
            beyond = origins[lost] + ahead[:, None] * directions[lost]
            further, face[lost] = self._cast_block(beyond, directions[lost], passes - 1)
            distance[lost] = ahead + further
        return distance, face

    def _cast_embree(
        self,
        origins: NDArray[np.float64],
        directions: NDArray[np.float64],
        limit: NDArray[np.float64] | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Embree's distances and faces."""
        limits = None if limit is None else limit.astype(np.float32)
        found = self._embree.run(
            origins.astype(np.float32), directions.astype(np.float32), dists=limits, output=True
        )
        return found["tfar"].astype(np.float64), found["primID"].astype(np.int64)

    def _intersect_near(
        self, at: NDArray[np.float64], along: NDArray[np.float64], faces: Sequence[int]
    ) -> tuple[float, int]:
        """Where a ray through a place meets the faces or a neighbour first, from there; (inf, -1): nowhere."""
        near = np.unique(np.concatenate([self._neighbouring_faces(face) for face in faces if face >= 0]))
        count = (len(near), 3)
        step, met = _intersect(
            np.broadcast_to(at, count), np.broadcast_to(along, count), self.corners_mm[near]
        )
        # a neighbour met farther off is another part of a large face's surroundings, and for the next cast
        met &= np.abs(step) * np.linalg.norm(along) < _WINDOW_MM
        if not met.any():
            return np.inf, -1
        first = int(np.argmin(np.where(met, step, np.inf)))
        return float(step[first]), int(near[first])

    def _neighbouring_faces(self, face: int) -> NDArray[np.int64]:
        """Faces that share a vertex with a face, itself among them."""
        spans = [slice(*self._first_by_vertex[vertex : vertex + 2]) for vertex in self._faces[face]]
        return np.concatenate([self._faces_by_vertex[span] for span in spans])


def _intersect(
    at: NDArray[np.float64], along: NDArray[np.float64], corners: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(N,) where lines from (N, 3) along (N, 3) meet the planes of triangles (N, 3, 3); (N,) whether within them."""
    a = corners[:, 0]
    ab, ac = corners[:, 1] - a, corners[:, 2] - a
    across = np.cross(along, ac)
    with np.errstate(divide="ignore", invalid="ignore"):  # a ray along a face: NaN is not within
        scale = 1 / (ab * across).sum(axis=1)
        from_a = at - a
        u = (from_a * across).sum(axis=1) * scale
        turned = np.cross(from_a, ab)
        v = (along * turned).sum(axis=1) * scale
        return (ac * turned).sum(axis=1) * scale, (u >= -_EDGE_TOLERANCE) & (v >= -_EDGE_TOLERANCE) & (
            u + v <= 1 + _EDGE_TOLERANCE
        )
