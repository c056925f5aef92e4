"""Rocks that fall onto a height map: each comes to rest on what lies below it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import SettingsError
from beltscape.simulate.geometry.ray_casting import RayScene
from beltscape.simulate.geometry.world import Label, Solid
from beltscape.simulate.solids.belt import BeltSettings
from beltscape.simulate.solids.fines import HeightField
from beltscape.simulate.solids.rocks import Rock

RASTER_MM = 1.0
"""Cell of the height map."""


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """A rock's lower and upper side on the raster, its centroid at the middle of the raster and at height 0."""

    bottom_mm: NDArray[np.float64]
    """(2·h + 1, 2·w + 1); inf beside the rock."""
    top_mm: NDArray[np.float64]
    """The same of the upper side; -inf beside the rock."""
    height_mm: float
    """From its lowest to its highest point."""

    @property
    def reach(self) -> tuple[int, int]:
        """(h, w): rows and columns to each side of the middle."""
        rows, columns = self.bottom_mm.shape
        return rows // 2, columns // 2

    def window(self, row: int, column: int) -> tuple[slice, slice]:
        """What it covers of a map when its middle is there."""
        rows, columns = self.reach
        return slice(row - rows, row + rows + 1), slice(column - columns, column + columns + 1)


def deposit_rocks(
    rocks: Sequence[Rock],
    fines: HeightField,
    belt: BeltSettings,
    *,
    bedding: float,
    candidates: int,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """(N, 3) where the rocks' centroids come to rest, falling in this order.

    Of ``candidates`` places on the fines (or, where there are none, on the belt) a rock stays where it lies lowest
    over them. It sinks into the fines by ``bedding`` of its height, but not into the belt or rocks below it.

    Raises
    ------
    SettingsError
        where the belt or the fines are too small for the largest rock.
    """
    prints = rasterise_rocks(rocks)
    maps = _HeightMaps(fines, belt)
    margins = np.max([rock.reach for rock in prints], axis=0, initial=0) if prints else np.zeros(2, int)
    spots = maps.candidate_cells(int(margins[0]), int(margins[1]))
    if prints and not len(spots):
        raise SettingsError(
            f"no place for rocks of {max(rock.size_mm for rock in rocks):.0f} mm: widen the belt or make them smaller"
        )
    at = np.empty((len(prints), 3))
    for i, rock in enumerate(prints):
        tries = spots[rng.integers(len(spots), size=candidates)].tolist()
        rests = [maps.rest_height_mm(rock, row, column, bedding) for row, column in tries]
        rises = [z - maps.fines_mm[row, column] for z, (row, column) in zip(rests, tries, strict=True)]
        best = int(np.argmin(rises))  # in a hollow rather than on top of others
        row, column = tries[best]
        maps.add(rock, row, column, rests[best])
        at[i] = maps.x_mm[column], maps.y_mm[row], rests[best]
    return at


def rasterise_rocks(rocks: Sequence[Rock]) -> list[Footprint]:
    """Every rock on the raster: all are laid out side by side and looked at from below and from above."""
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
    eyes = np.concatenate(
        [grid * RASTER_MM + middle[:2] for grid, middle in zip(grids, middles, strict=True)]
    )
    sides = []
    for sign in (1.0, -1.0):  # up from below, then down from above
        start = np.column_stack([eyes, np.full(len(eyes), -sign * pitch)])
        way = np.tile([0.0, 0.0, sign], (len(eyes), 1))
        sides.append(np.split(sign * (scene.cast(start, way).distance - pitch), ends))
    return [
        Footprint(
            bottom.reshape(2 * h + 1, 2 * w + 1),
            top.reshape(2 * h + 1, 2 * w + 1),
            float(np.ptp(rock.mesh.vertices_mm[:, 2])),
        )
        for rock, (h, w), bottom, top in zip(rocks, reach, *sides, strict=True)
    ]


class _HeightMaps:
    """Height maps on the raster: belt, fines, and the tops of the rocks so far, -inf where there are none."""

    def __init__(self, fines: HeightField, belt: BeltSettings) -> None:
        left, right = belt.half_width_mm
        half = belt.length_mm / 2
        self.x_mm = RASTER_MM * np.arange(np.ceil(-left / RASTER_MM), np.floor(right / RASTER_MM) + 1)
        self.y_mm = RASTER_MM * np.arange(np.ceil(-half / RASTER_MM), np.floor(half / RASTER_MM) + 1)
        self.belt_mm = belt.height_at(self.x_mm, self.y_mm[:, None])
        self.fines_mm = fines.height_at(self.x_mm, self.y_mm[:, None])
        self.rocks_mm = np.full(self.fines_mm.shape, -np.inf)

    def candidate_cells(self, rows: int, columns: int) -> NDArray[np.int64]:
        """(K, 2) row and column of places so far from the edge: with fines, or without any all of the belt."""
        there = self.fines_mm > self.belt_mm
        inner = np.zeros(there.shape, bool)
        inner[rows : len(self.y_mm) - rows, columns : len(self.x_mm) - columns] = True
        return np.argwhere(inner & there if there.any() else inner)

    def rest_height_mm(self, rock: Footprint, row: int, column: int, bedding: float) -> float:
        """Height at which a rock's centroid stops when it falls there."""
        window = rock.window(row, column)
        hard = np.maximum(self.belt_mm[window], self.rocks_mm[window])
        below = np.maximum(hard, self.fines_mm[window] - bedding * rock.height_mm)
        return float((below - rock.bottom_mm).max())

    def add(self, rock: Footprint, row: int, column: int, height: float) -> None:
        """Leave a rock there."""
        tops = self.rocks_mm[rock.window(row, column)]
        np.maximum(tops, rock.top_mm + height, out=tops)
