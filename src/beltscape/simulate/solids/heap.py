"""A heap on the belt: rocks deposited one after another on fines and on each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.simulate.geometry.world import Solid
from beltscape.simulate.solids.belt import BeltSettings
from beltscape.simulate.solids.deposition import deposit_rocks
from beltscape.simulate.solids.fines import FinesSettings, HeightField, make_fines, make_fines_mesh
from beltscape.simulate.solids.material import ReflectanceModel, make_fines_solid, make_rocks_solid
from beltscape.simulate.solids.rock_sizes import SizeSettings, draw_sizes
from beltscape.simulate.solids.rocks import Rock, ShapeSettings, make_rock


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
    reflectance: Annotated[float, Field(gt=0, le=1)] = 0.09
    """Mean diffuse reflectance of the rocks: coal 0.05, ore and gravel up to 0.4."""
    spread: Annotated[float, Field(ge=0, le=0.6)] = 0.3
    """Relative standard deviation of the reflectance from rock to rock, and from grain to grain of the fines."""
    mottle: Annotated[float, Field(ge=0, le=0.6)] = 0.15
    """Relative standard deviation of the reflectance over a rock's faces, in spots of some millimetres."""


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
        rocks, fines, belt, bedding=settings.bedding, candidates=settings.candidates, rng=rng
    )
    rng = np.random.default_rng(shade_seed)
    reflectance_model = ReflectanceModel(settings.reflectance, settings.spread, settings.mottle)
    solids: list[Solid] = []
    crust = make_fines_mesh(fines, belt)
    if len(crust.faces):
        solids.append(make_fines_solid(crust, reflectance_model, rng))
    if rocks:
        solids.append(make_rocks_solid([rock.mesh for rock in rocks], centers, reflectance_model, rng))
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
