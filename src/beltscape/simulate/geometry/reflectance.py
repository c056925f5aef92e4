"""Reflectance of surfaces at ray hits, textures included."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.simulate.geometry.ray_casting import RayScene
from beltscape.simulate.geometry.world import Solid


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
