"""The fines of a heap: a height field on the belt whose slopes stay below the angle of repose.

The reflectance of fines and rocks has grains, shades from rock to rock, and spots on their faces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from beltscape.simulate.shapes import Mesh, join_meshes, triangulate_height_field
from beltscape.simulate.solids.belt import BeltSettings
from beltscape.simulate.world import Label, Solid

Millimetres = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
_HIDDEN_MM = 2.0
"""Depth of the field below the belt where there are no fines, so that it intersects the belt along a clean line."""


class FinesSettings(BaseModel):
    """A ridge of fines along the belt."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    crown_mm: Annotated[float, Field(ge=0, le=2000)] = 80.0
    """Height of the ridge above the level middle of the belt."""
    crown_x_mm: Annotated[float, Field(ge=-2000, le=2000)] = 0.0
    """Lateral position of the ridge."""
    surcharge_deg: Annotated[float, Field(ge=0, le=60)] = 15.0
    """Slope of the flanks while the belt runs."""
    repose_deg: Annotated[float, Field(gt=0, le=80)] = 35.0
    """Angle of repose: the largest slope from node to node, apart from the grain."""
    waves_mm: Annotated[float, Field(ge=0, le=500)] = 6.0
    """Standard deviation of hills and hollows."""
    wavelength_mm: Millimetres = 120.0
    """Approximate distance between hills."""
    grain_mm: Annotated[float, Field(ge=0, le=20)] = 0.4
    """Standard deviation of the height from node to node, added to slopes and hills."""
    along_mm: tuple[float, float] = (-600.0, 600.0)
    """Start and end of the ridge along the belt; its ends slope at the angle of repose."""
    cell_mm: Annotated[float, Field(ge=0.5, le=50)] = 3.0

    @model_validator(mode="after")
    def _check_order(self) -> FinesSettings:
        if not self.along_mm[0] < self.along_mm[1]:
            raise ValueError(f"along_mm = {list(self.along_mm)}: the first must be smaller than the second")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class HeightField:
    """A surface over a grid, triangulated as by `triangulate_height_field`."""

    x_mm: NDArray[np.float64]
    """(Nx,) evenly spaced."""
    y_mm: NDArray[np.float64]
    """(Ny,) evenly spaced."""
    height_mm: NDArray[np.float64]
    """(Ny, Nx)."""

    def height_at(self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the height of the triangles at x, y (broadcast), mm; -inf beside the field."""
        u = (np.asarray(x_mm) - self.x_mm[0]) / (self.x_mm[1] - self.x_mm[0])
        v = (np.asarray(y_mm) - self.y_mm[0]) / (self.y_mm[1] - self.y_mm[0])
        rows, columns = self.height_mm.shape
        inside = (u >= 0) & (v >= 0) & (u <= columns - 1) & (v <= rows - 1)
        i = np.clip(u.astype(int), 0, columns - 2)
        j = np.clip(v.astype(int), 0, rows - 2)
        u, v, z = u - i, v - j, self.height_mm
        corner = np.where(
            u >= v, z[j, i + 1], z[j + 1, i]
        )  # the corner of the triangle that contains the point
        high, low = np.maximum(u, v), np.minimum(u, v)
        height = z[j, i] + high * (corner - z[j, i]) + low * (z[j + 1, i + 1] - corner)
        return np.where(inside, height, -np.inf)


def make_fines(settings: FinesSettings, belt: BeltSettings, rng: np.random.Generator) -> HeightField:
    """Return the fines over the whole belt; where there are none, the field runs just below the belt."""
    from scipy.ndimage import gaussian_filter

    left, right = belt.half_width_mm
    x = np.linspace(-left, right, int(np.ceil((left + right) / settings.cell_mm)) + 1)
    half = belt.length_mm / 2
    y = np.linspace(-half, half, int(np.ceil(belt.length_mm / settings.cell_mm)) + 1)
    ground = belt.height_at(x, y[:, None])
    aside = np.hypot(x - settings.crown_x_mm, 30.0) - 30.0  # a rounded ridge
    beyond = np.maximum(settings.along_mm[0] - y, y - settings.along_mm[1]).clip(min=0)
    slope = np.tan(np.deg2rad(settings.repose_deg))
    top = settings.crown_mm - np.tan(np.deg2rad(settings.surcharge_deg)) * aside - slope * beyond[:, None]
    waves = gaussian_filter(rng.normal(size=(len(y), len(x))), settings.wavelength_mm / 4 / settings.cell_mm)
    top += settings.waves_mm * waves / max(float(waves.std()), 1e-12)
    top[:, [0, -1]] = ground[:, [0, -1]] - _HIDDEN_MM  # material beyond the edge falls off
    below = ground - _HIDDEN_MM
    top = limit_slope(np.maximum(top, below), x[1] - x[0], y[1] - y[0], slope, below)
    grains = settings.grain_mm * rng.normal(size=top.shape)
    return HeightField(x, y, np.where(top > below, np.maximum(top + grains, below), below))


def limit_slope(
    height_mm: NDArray[np.float64], dx_mm: float, dy_mm: float, slope: float, ground_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (Ny, Nx) the highest surface that is nowhere above ``height_mm`` nor steeper than ``slope``.

    It is not lowered below the ground. Slopes are limited between each node and its eight neighbours.
    """
    neighbours = {
        (0, 1): dx_mm,
        (1, 0): dy_mm,
        (1, 1): np.hypot(dx_mm, dy_mm),
        (1, -1): np.hypot(dx_mm, dy_mm),
    }
    height = height_mm.copy()
    while True:
        previous = height.copy()
        for (j, i), distance in neighbours.items():
            first = (slice(0, -j or None), slice(max(-i, 0), -i if i > 0 else None))
            second = (slice(j, None), slice(max(i, 0), i if i < 0 else None))
            np.minimum(height[first], height[second] + slope * distance, out=height[first])
            np.minimum(height[second], height[first] + slope * distance, out=height[second])
        np.maximum(height, ground_mm, out=height)  # the belt's own slope may be steeper
        if np.array_equal(height, previous):
            return height


def make_fines_mesh(field: HeightField, belt: BeltSettings) -> Mesh:
    """Return the part of the field that lies above the belt, and the cells around it."""
    whole = triangulate_height_field(field.x_mm, field.y_mm, field.height_mm)
    above = (field.height_mm > belt.height_at(field.x_mm, field.y_mm[:, None])).ravel()
    faces = whole.faces.reshape(-1, 6)  # both triangles of a cell
    faces = faces[above[faces].any(axis=1)].reshape(-1, 3)
    used, index = np.unique(faces, return_inverse=True)
    return Mesh(whole.vertices_mm[used], index.reshape(faces.shape))


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
