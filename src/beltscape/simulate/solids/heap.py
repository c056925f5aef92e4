"""A heap on the belt: rocks deposited one after another on fines and on each other.

Each rock falls vertically on a height map and stops on what lies below it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.errors import SettingsError
from beltscape.simulate.ray_casting import RayScene
from beltscape.simulate.solids.belt import BeltSettings
from beltscape.simulate.solids.fines import (
    FinesSettings,
    HeightField,
    ReflectanceModel,
    make_fines,
    make_fines_mesh,
    make_fines_solid,
    make_rocks_solid,
)
from beltscape.simulate.solids.rocks import Rock, ShapeSettings, SizeSettings, draw_sizes, make_rock
from beltscape.simulate.world import Label, Solid

RASTER_MM = 1.0
"""Cell size of the height map."""


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """The lower and upper side of a rock on the raster; its centroid is at the central cell and at height 0."""

    bottom_mm: NDArray[np.float64]
    """(2·h + 1, 2·w + 1) lower side; inf beside the rock."""
    top_mm: NDArray[np.float64]
    """(2·h + 1, 2·w + 1) upper side; -inf beside the rock."""
    height_mm: float
    """From the lowest to the highest point."""

    @property
    def reach(self) -> tuple[int, int]:
        """Return (h, w): rows and columns on each side of the central cell."""
        rows, columns = self.bottom_mm.shape
        return rows // 2, columns // 2

    def window(self, row: int, column: int) -> tuple[slice, slice]:
        """Return the slices of a map that the rock covers when its centre is at a cell."""
        rows, columns = self.reach
        return slice(row - rows, row + rows + 1), slice(column - columns, column + columns + 1)


def deposit_rocks(
    rocks: Sequence[Rock],
    fines: HeightField,
    belt: BeltSettings,
    *,
    bedding: float,
    candidates: int,
    rolling: float = 0.0,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Return (N, 3) final positions of the centroids of rocks that fall in the given order.

    Of ``candidates`` random cells with fines (or of the belt, where there are no fines) the rock is placed where it
    lies lowest above the fines (``rolling`` 0) or lowest of all (1). It sinks into the fines by ``bedding`` of its
    height, not into belt or rocks.

    Raises
    ------
    SettingsError
        If the belt or the fines are too small for the largest rock.
    """
    footprints = rasterise_rocks(rocks)
    maps = _HeightMaps(fines, belt)
    margins = (
        np.max([rock.reach for rock in footprints], axis=0, initial=0) if footprints else np.zeros(2, int)
    )
    cells = maps.candidate_cells(int(margins[0]), int(margins[1]))
    if footprints and not len(cells):
        raise SettingsError(
            f"no place for rocks of {max(rock.size_mm for rock in rocks):.0f} mm: widen the belt or make them smaller"
        )
    centers = np.empty((len(footprints), 3))
    for i, rock in enumerate(footprints):
        tried = cells[rng.integers(len(cells), size=candidates)].tolist()
        heights = [maps.rest_height_mm(rock, row, column, bedding) for row, column in tried]
        rises = [
            z - (1 - rolling) * maps.fines_mm[row, column]
            for z, (row, column) in zip(heights, tried, strict=True)
        ]
        best = int(np.argmin(rises))  # hollows are filled first
        row, column = tried[best]
        maps.add(rock, row, column, heights[best])
        centers[i] = maps.x_mm[column], maps.y_mm[row], heights[best]
    return centers


def rasterise_rocks(rocks: Sequence[Rock]) -> list[Footprint]:
    """Return the footprint of every rock; all are laid out side by side and ray-cast from below and from above."""
    if not rocks:
        return []
    reach = [np.ceil(np.abs(rock.mesh.vertices_mm[:, :2]).max(axis=0)).astype(int)[::-1] for rock in rocks]
    pitch = 2.0 * np.max(reach) + 10.0
    per_row = int(np.ceil(np.sqrt(len(rocks))))
    number = np.arange(len(rocks))
    middles = np.column_stack([number % per_row, number // per_row, np.zeros(len(rocks))]) * pitch
    middles -= middles.mean(axis=0)
    scene = RayScene(
        [
            Solid("", Label.MATERIAL, rock.mesh.vertices_mm + middle, rock.mesh.faces, (0.0, 0.0, 0.0))
            for rock, middle in zip(rocks, middles, strict=True)
        ]
    )
    grids = [np.indices((2 * h + 1, 2 * w + 1)).reshape(2, -1)[::-1].T - [w, h] for h, w in reach]
    ends = np.cumsum([len(grid) for grid in grids])[:-1]
    origins = np.concatenate(
        [grid * RASTER_MM + middle[:2] for grid, middle in zip(grids, middles, strict=True)]
    )
    sides: list[list[NDArray[np.float64]]] = []
    for sign in (1.0, -1.0):  # rays upwards, then downwards
        start = np.column_stack([origins, np.full(len(origins), -sign * pitch)])
        directions = np.tile([0.0, 0.0, sign], (len(origins), 1))
        sides.append(np.split(sign * (scene.cast(start, directions).distance - pitch), ends))
    return [
        Footprint(
            bottom.reshape(2 * h + 1, 2 * w + 1),
            top.reshape(2 * h + 1, 2 * w + 1),
            float(np.ptp(rock.mesh.vertices_mm[:, 2])),
        )
        for rock, (h, w), bottom, top in zip(rocks, reach, *sides, strict=True)
    ]


class _HeightMaps:
    """Height maps on the raster: belt, fines, and the tops of the rocks so far (-inf where there are none)."""

    def __init__(self, fines: HeightField, belt: BeltSettings) -> None:
        left, right = belt.half_width_mm
        half = belt.length_mm / 2
        self.x_mm = RASTER_MM * np.arange(
            float(np.ceil(-left / RASTER_MM)), float(np.floor(right / RASTER_MM) + 1)
        )
        self.y_mm = RASTER_MM * np.arange(
            float(np.ceil(-half / RASTER_MM)), float(np.floor(half / RASTER_MM) + 1)
        )
        self.belt_mm = belt.height_at(self.x_mm, self.y_mm[:, None])
        self.fines_mm = fines.height_at(self.x_mm, self.y_mm[:, None])
        self.rocks_mm = np.full(self.fines_mm.shape, -np.inf)

    def candidate_cells(self, rows: int, columns: int) -> NDArray[np.int64]:
        """Return (K, 2) row and column of cells off the edge that have fines; without any fines all such cells."""
        has_fines = self.fines_mm > self.belt_mm
        is_inner = np.zeros(has_fines.shape, bool)
        is_inner[rows : len(self.y_mm) - rows, columns : len(self.x_mm) - columns] = True
        return np.argwhere(is_inner & has_fines if has_fines.any() else is_inner)

    def rest_height_mm(self, rock: Footprint, row: int, column: int, bedding: float) -> float:
        """Return the height at which the centroid of a rock comes to rest at a cell."""
        window = rock.window(row, column)
        solid = np.maximum(self.belt_mm[window], self.rocks_mm[window])
        support = np.maximum(solid, self.fines_mm[window] - bedding * rock.height_mm)
        return float((support - rock.bottom_mm).max())

    def add(self, rock: Footprint, row: int, column: int, height: float) -> None:
        """Add a rock to the map of tops."""
        tops = self.rocks_mm[rock.window(row, column)]
        np.maximum(tops, rock.top_mm + height, out=tops)


class HeapSettings(BaseModel):
    """Rocks on fines."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    seed: Annotated[int, Field(ge=0)] = 0
    rocks: Annotated[int, Field(ge=0, le=100_000)] = 1300
    sizes: SizeSettings = SizeSettings()
    shapes: ShapeSettings = ShapeSettings()
    fines: FinesSettings = FinesSettings()
    bedding: Annotated[float, Field(ge=0, le=0.3)] = 0.15
    """Depth to which a rock sinks into the fines, as a share of its height; it never sinks into belt or rocks."""
    candidates: Annotated[int, Field(ge=1, le=100)] = 6
    """Positions tried for each rock; it is placed where it lies lowest above the fines."""
    rolling: Annotated[float, Field(ge=0, le=1)] = 0.0
    """1: it is placed where it lies lowest of all, as if it had rolled down the heap; between: both weighed."""
    reflectance: Annotated[float, Field(gt=0, le=1)] = 0.09
    """Mean diffuse reflectance of the rocks: coal 0.05, ore and gravel up to 0.4."""
    spread: Annotated[float, Field(ge=0, le=0.6)] = 0.3
    """Relative standard deviation of the reflectance from rock to rock, and from grain to grain of the fines."""
    mottle: Annotated[float, Field(ge=0, le=0.6)] = 0.15
    """Relative standard deviation of the reflectance over a rock's faces, in spots of some millimetres."""
    gloss: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of the light that the rocks reflect as rough plastic does, such as wet coal or pellets; 0: matt."""


@dataclass(frozen=True, slots=True, eq=False)
class Rocks:
    """The true rocks of a heap, in the order of their deposition; N rocks."""

    center_mm: NDArray[np.float64]
    """(N, 3) centroids of their volumes, in the world."""
    size_mm: NDArray[np.float64]
    """(N,) extents along the middle principal axis, approximately the sieve sizes that the rocks just pass."""
    volume_mm3: NDArray[np.float64]
    """(N,)."""
    first_vertex: NDArray[np.int64]
    """(N + 1,) rock i has the vertices first_vertex[i] … first_vertex[i + 1] − 1 of the solid "rocks"."""
    first_face: NDArray[np.int64]
    """(N + 1,) the same for faces."""


@dataclass(frozen=True, slots=True, eq=False)
class Heap:
    """Fines, rocks, and their solids."""

    fines: HeightField
    """Over the whole belt; just below the belt where there are no fines."""
    rocks: Rocks
    solids: tuple[Solid, ...]
    """Named "fines" and "rocks" where there are any; all rocks form one mesh; both are labelled MATERIAL."""


def make_heap(settings: HeapSettings, belt: BeltSettings) -> Heap:
    """Return a heap on a belt; the same settings give the same heap.

    Every rock touches the belt or a rock below it, or lies `HeapSettings.bedding` of its height deep in the fines.
    On the raster of 1 mm it intersects nothing else; between the raster's points rocks may intersect slightly.
    """
    # a separate random stream for each, so that more rocks do not change the fines
    fines_seed, size_seed, shape_seed, position_seed, shade_seed = np.random.SeedSequence(
        settings.seed
    ).spawn(5)
    fines = make_fines(settings.fines, belt, np.random.default_rng(fines_seed))
    sizes = draw_sizes(settings.sizes, settings.rocks, np.random.default_rng(size_seed))
    rng = np.random.default_rng(shape_seed)
    rocks = [make_rock(size, settings.shapes, rng) for size in sizes.tolist()]
    rng = np.random.default_rng(position_seed)
    centers = deposit_rocks(
        rocks, fines, belt, bedding=settings.bedding, candidates=settings.candidates, rolling=settings.rolling,
        rng=rng,
    )  # fmt: skip
    rng = np.random.default_rng(shade_seed)
    reflectance_model = ReflectanceModel(settings.reflectance, settings.spread, settings.mottle)
    solids: list[Solid] = []
    crust = make_fines_mesh(fines, belt)
    if len(crust.faces):
        solids.append(make_fines_solid(crust, reflectance_model, rng))
    if rocks:
        matt = make_rocks_solid([rock.mesh for rock in rocks], centers, reflectance_model, rng)
        solids.append(replace(matt, gloss=settings.gloss))
    return Heap(fines, _records(rocks, centers), tuple(solids))


def shift_solids(solids: Sequence[Solid], along_mm: float) -> tuple[Solid, ...]:
    """Return the solids after the belt has carried them by ``along_mm`` towards +y."""
    return tuple(solid.shift(along_mm) for solid in solids)


def _records(rocks: list[Rock], at_mm: NDArray[np.float64]) -> Rocks:
    """Return the true rocks with their centroids at positions (N, 3)."""
    return Rocks(
        center_mm=at_mm,
        size_mm=np.array([rock.size_mm for rock in rocks]),
        volume_mm3=np.array([rock.mesh.volume_mm3 for rock in rocks]),
        first_vertex=np.cumsum([0, *(len(rock.mesh.vertices_mm) for rock in rocks)]),
        first_face=np.cumsum([0, *(len(rock.mesh.faces) for rock in rocks)]),
    )
