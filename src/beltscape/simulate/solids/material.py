"""The reflectance of fines and rocks: grains, shades from rock to rock, and spots on their faces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.simulate.geometry.shapes import Mesh, join_meshes
from beltscape.simulate.geometry.world import Label, Solid

_TILES = 8
"""Tiles of the texture in each direction; see `_TILE_PX`."""
_TILE_PX = 128
"""A rock's texture is one of 8 × 8 tiles, each of one shade; a texel is a millimetre (more for very large rocks)."""
_BORDER_PX = 2
"""Border of a tile that no rock uses, so that interpolation mixes no tiles."""


@dataclass(frozen=True, slots=True)
class ReflectanceModel:
    """The diffuse reflectance of bulk material, log-normally distributed."""

    mean: float
    spread: float
    """Relative standard deviation from rock to rock, and from grain to grain of the fines."""
    mottle: float
    """Relative standard deviation over a rock's faces."""

    def scale_factors(self, normal: NDArray[np.floating], spread: float) -> NDArray[np.float64]:
        """Return log-normal factors of mean 1 and this relative standard deviation from standard normal numbers."""
        sigma = np.sqrt(np.log1p(spread**2))
        return np.exp(sigma * normal - sigma**2 / 2)

    def make_texture(self, factors: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return (h, w, 3) grey reflectances: the mean times factors (h, w)."""
        return np.repeat(np.clip(self.mean * factors, 0.005, 0.95)[..., None], 3, axis=2).astype(np.float32)


def make_fines_solid(mesh: Mesh, reflectance_model: ReflectanceModel, rng: np.random.Generator) -> Solid:
    """Return the fines with a texture of grains: one texel a millimetre, projected from above."""
    low, high = mesh.vertices_mm[:, :2].min(axis=0), mesh.vertices_mm[:, :2].max(axis=0)
    columns, rows = np.ceil(high - low).astype(int).tolist()
    texture = reflectance_model.make_texture(
        reflectance_model.scale_factors(rng.normal(size=(rows, columns)), reflectance_model.spread)
    )
    uv = (mesh.vertices_mm[:, :2] - low) / (high - low)
    return Solid("fines", Label.MATERIAL, mesh.vertices_mm, mesh.faces, (1.0, 1.0, 1.0), texture, uv)


def make_rocks_solid(
    meshes: Sequence[Mesh],
    at_mm: NDArray[np.float64],
    reflectance_model: ReflectanceModel,
    rng: np.random.Generator,
) -> Solid:
    """Return all rocks, shifted to positions (N, 3), as one mesh; each rock has a tile of the one texture."""
    mesh = join_meshes([Mesh(one.vertices_mm + at, one.faces) for one, at in zip(meshes, at_mm, strict=True)])
    tiles = rng.integers(_TILES, size=(len(meshes), 2))
    uv = np.concatenate([_map_to_tile(one, tile) for one, tile in zip(meshes, tiles, strict=True)])
    size = _TILES * _TILE_PX
    tone = np.kron(rng.normal(size=(_TILES, _TILES)), np.ones((_TILE_PX, _TILE_PX)))
    factors = reflectance_model.scale_factors(
        tone, reflectance_model.spread
    ) * reflectance_model.scale_factors(_draw_spots(size, rng), reflectance_model.mottle)
    texture = reflectance_model.make_texture(factors)
    return Solid("rocks", Label.MATERIAL, mesh.vertices_mm, mesh.faces, (1.0, 1.0, 1.0), texture, uv)


def _map_to_tile(mesh: Mesh, tile: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (V, 2) texture coordinates by an oblique projection, so that steep faces have spots and not stripes."""
    flat = mesh.vertices_mm[:, :2] + mesh.vertices_mm[:, 2:] * [0.6, 0.8]
    flat = flat - flat.min(axis=0)
    room = _TILE_PX - 2 * _BORDER_PX
    flat *= min(1.0, room / float(flat.max()))
    return (tile * _TILE_PX + _BORDER_PX + flat) / (_TILES * _TILE_PX)


def _draw_spots(size: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw (size, size) standard normal numbers, correlated over a few texels at two scales."""
    from scipy.ndimage import gaussian_filter

    layers = [gaussian_filter(rng.normal(size=(size, size)), sigma) for sigma in (0.8, 3.0)]
    spots = sum((layer / layer.std() for layer in layers), np.zeros((size, size)))
    return spots / spots.std()
