"""The truth of a simulated capture as files. Everything is in mm; poses are named as in rig.json.

| file | content |
|---|---|
| `rig.json` | the true rig, in the format of `beltscape calibrate` |
| `station.json` | `core_from_world`; the world: x across, y along, z up, origin on the empty belt under the rig |
| `projector.json` | size, focal, centre, distortion, `projector_from_world`, power |
| `belt.json` | the belt's settings and `cross_section_mm`, x and z of its upper side under the rig |
| `board_poses.json` | the board, and by frame `world_from_board`, `core_from_board`, corners in each camera's image |
| `<name>_depth.npz` | see below |
| `<name>_scene.json` | labels by name, measurable shares of pixels (`ceilings`), volume of the load in a box |
| `<name>_load.npz` | the load's heights over the box: `x_mm`, `y_mm`, `height_mm` (float32), `area_mm2` at each y |
| `<name>_module.json` | true dimensions and positions of a module's features, `world_from_module` |
| `<name>_rocks.npz` | by rock: `center_mm` (world), `size_mm`, `volume_mm3` |

`<name>_depth.npz` holds on the core's pinhole grid, as depth.tiff: `depth_mm` (float32, NaN: no surface), `label`,
`views` (number of auxiliaries that see the point), `lit`, `rock` (index in `<name>_rocks.npz`, -1: none); and on the
recorded image: `depth_distorted_mm`, `label_distorted`.

A moving belt's `belt_moving_load.npz` has `rock` too, seen from above, and its `belt_moving_depth.npz` holds
`depth_mm`, `label` and `rock` by frame.

The true volume of the load is the space between the belt and the surface seen from vertically above; the true
dimensions of a module are listed by the quantities that are measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.pose import Pose
from beltscape.files.arrays import write_arrays
from beltscape.files.json_text import write_json
from beltscape.files.rig_json import write_rig
from beltscape.simulate.core_truth import (
    CoreTruth,
    CoreView,
    index_rocks,
    is_in_image,
    label_rocks,
    measurable_shares,
    trace_core_truth,
    trace_core_view,
)
from beltscape.simulate.ray_casting import RayScene
from beltscape.simulate.solids.belt import BeltSettings
from beltscape.simulate.solids.heap import Heap
from beltscape.simulate.world import Label, Projector, Station, World
from beltscape.target.board import Board, corner_points_mm
from beltscape.target.module import Cube, Cylinder, Feature, Module

_ABOVE_MM = 100.0
"""Height of the ray origins above the highest vertex."""
_DOWN = (0.0, 0.0, -1.0)
"""Direction of the rays, in the world's frame."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueLoad:
    """The load over a box of the belt, vertical in the world; overhangs count as solid."""

    x_mm: NDArray[np.float64]
    """(Nx,) centres of the cells."""
    y_mm: NDArray[np.float64]
    """(Ny,)."""
    height_mm: NDArray[np.float64]
    """(Ny, Nx) height above the empty belt, never below 0; 0 beside the belt."""
    across_mm: tuple[float, float]
    """Extent of the box in x."""
    along_mm: tuple[float, float]
    """Extent of the box in y."""

    @property
    def volume_mm3(self) -> float:
        """Return the integral over the box, by the midpoint rule."""
        return float(self.height_mm.mean()) * self._surface_mm2

    @property
    def spread_mm3(self) -> float:
        """Return the standard deviation of the volumes from each fourth cell: an upper bound of the error of all."""
        parts = [self.height_mm[j::2, i::2].mean() for j in (0, 1) for i in (0, 1)]
        return float(np.std(parts, ddof=1)) * self._surface_mm2

    @property
    def area_mm2(self) -> NDArray[np.float64]:
        """Return (Ny,) the cross-section of the load at each y."""
        return self.height_mm.mean(axis=1) * (self.across_mm[1] - self.across_mm[0])

    @property
    def _surface_mm2(self) -> float:
        (left, right), (first, last) = self.across_mm, self.along_mm
        return (right - left) * (last - first)


def compute_true_load(
    world: World, across_mm: tuple[float, float], along_mm: tuple[float, float], step_mm: float = 0.5
) -> TrueLoad:
    """Measure the load by vertical rays to the world and to its belt alone, one for every cell of about ``step_mm``.

    Everything but belt, floor and what has no label counts as load where it lies above the belt.
    """
    x, y = (_cell_centres(*ends, step_mm) for ends in (across_mm, along_mm))
    return TrueLoad(x, y, _load_heights(world, x, y), across_mm, along_mm)


def compute_true_area_mm2(
    world: World, y_mm: NDArray[np.float64], across_mm: tuple[float, float], step_mm: float = 0.25
) -> NDArray[np.float64]:
    """Return (N,) the load's exact cross-section at positions along the belt (N,)."""
    heights = _load_heights(world, _cell_centres(*across_mm, step_mm), np.asarray(y_mm, np.float64))
    return heights.mean(axis=1) * (across_mm[1] - across_mm[0])


def _load_heights(world: World, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (Ny, Nx) heights of the load above the belt."""
    x, y = np.meshgrid(x_mm, y_mm)
    solids = [solid for solid in world.solids if solid.label != Label.NOTHING]
    high = max(float(solid.vertices_mm[:, 2].max()) for solid in solids) + _ABOVE_MM
    eyes = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, high)])
    scene = RayScene(solids)
    loaded = scene.cast(eyes, np.broadcast_to(_DOWN, eyes.shape))
    is_covered = loaded.face >= 0
    is_covered[is_covered] = scene.label_of_face[loaded.face[is_covered]] != Label.BELT
    rest = eyes[is_covered]
    belt = RayScene([solid for solid in world.solids if solid.label == Label.BELT])
    below = belt.cast(rest, np.broadcast_to(_DOWN, rest.shape)).distance
    height = np.zeros(x.size)
    height[is_covered] = np.where(
        np.isfinite(below), np.maximum(below - loaded.distance[is_covered], 0.0), 0.0
    )
    return height.reshape(x.shape)


def label_rocks_from_above(
    world: World, heap: Heap, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]
) -> NDArray[np.int32]:
    """Return (Ny, Nx) the index of the heap's rock that a vertical ray meets first, -1: none."""
    x, y = np.meshgrid(x_mm, y_mm)
    high = max(float(solid.vertices_mm[:, 2].max()) for solid in world.solids) + _ABOVE_MM
    eyes = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, high)])
    scene = RayScene(world.solids)
    face = scene.cast(eyes, np.broadcast_to(_DOWN, eyes.shape)).face
    solid = np.where(face >= 0, scene.solid_of_face[face], -1)
    return index_rocks(solid, face - scene.first_face[solid], world.solids, heap).reshape(x.shape)


def write_rocks(path: Path, heap: Heap) -> None:
    """Write the file of a heap's rocks, as described above."""
    rocks = heap.rocks
    write_arrays(path, center_mm=rocks.center_mm, size_mm=rocks.size_mm, volume_mm3=rocks.volume_mm3)


def _cell_centres(first: float, last: float, step_mm: float) -> NDArray[np.float64]:
    """Return (N,) centres of an even number of equal cells."""
    count = 2 * max(1, int(np.ceil((last - first) / step_mm / 2 - 1e-9)))
    return first + (np.arange(count, dtype=np.float64) + 0.5) / count * (last - first)


def describe_module(module: Module, world_from_module: Pose) -> dict[str, Any]:
    """Return the document of `<name>_module.json`.

    ``features`` has an entry ``{"name", "quantity", "true_mm"}`` for each quantity that the measurement of features
    returns; ``places`` holds the height of the top above the level belt's plane z = 0 and the centre of each
    footprint, in the world.
    """
    length, width, _ = module.base.size_mm
    entries = [("base", "length", length), ("base", "width", width)]
    for feature in module.features:
        entries += [(feature.name, quantity, value) for quantity, value in _list_quantities(feature)]
    cubes = sorted(module.cube, key=lambda cube: -cube.edge_mm)
    entries += [
        (f"step:{large.name}-{small.name}", "height_difference", large.edge_mm - small.edge_mm)
        for large, small in pairwise(cubes)
    ]
    return {
        "units": "mm",
        "world_from_module": {
            "rotation": world_from_module.rotation,
            "translation_mm": world_from_module.translation_mm,
        },
        "features": [
            {"name": name, "quantity": quantity, "true_mm": value} for name, quantity, value in entries
        ],
        "places": {feature.name: _locate(feature, world_from_module) for feature in module.features},
    }


def _list_quantities(feature: Feature) -> list[tuple[str, float]]:
    if isinstance(feature, Cube):
        return [("edge", feature.edge_mm), ("height", feature.edge_mm)]
    if isinstance(feature, Cylinder):
        return [("diameter", feature.diameter_mm), ("height", feature.height_mm)]
    return [("radius", feature.diameter_mm / 2)]


def _locate(feature: Feature, world_from_module: Pose) -> dict[str, Any]:
    if isinstance(feature, Cube):
        height = feature.edge_mm
    else:
        height = feature.height_mm if isinstance(feature, Cylinder) else feature.diameter_mm
    foot = world_from_module.translation_mm + world_from_module.rotation[:, :2] @ feature.center_mm
    return {"footprint_mm": foot, "top_mm": foot[2] + height}


@dataclass(frozen=True, slots=True, eq=False)
class SceneDetails:
    """The truth of a scene beyond its solids."""

    belt: BeltSettings
    heap: Heap | None = None
    module: Module | None = None
    world_from_module: Pose | None = None
    """Pose of the module."""
    across_mm: tuple[float, float] | None = None
    """Extent of the volume's box in x; by default the width of the belt."""
    along_mm: tuple[float, float] = (-200.0, 200.0)
    """Extent of the volume's box in y."""


def write_truth(folder: Path, name: str, world: World, station: Station, details: SceneDetails) -> None:
    """Write the whole truth of one scene into a folder, and the rig's truth beside it."""
    write_station(folder, station, world.projector)
    write_belt(folder, details.belt)
    scene = RayScene(world.solids)
    truth = trace_core_truth(world, station, scene=scene)
    image = trace_core_view(world, station, distorted=True, scene=scene)
    write_depth(folder / f"{name}_depth.npz", world, truth, image, details.heap)
    left, right = details.belt.half_width_mm
    load = compute_true_load(world, details.across_mm or (-left, right), details.along_mm)
    write_arrays(
        folder / f"{name}_load.npz",
        x_mm=load.x_mm,
        y_mm=load.y_mm,
        height_mm=load.height_mm.astype(np.float32),
        area_mm2=load.area_mm2,
    )
    write_json(folder / f"{name}_scene.json", _summary(world, truth, load))
    if details.module is not None and details.world_from_module is not None:
        document = describe_module(details.module, details.world_from_module)
        write_json(folder / f"{name}_module.json", document)
    if details.heap is not None:
        write_rocks(folder / f"{name}_rocks.npz", details.heap)


def write_station(folder: Path, station: Station, projector: Projector | None) -> None:
    """Write rig.json, station.json, and projector.json where there is a projector."""
    write_rig(folder / "rig.json", station.rig)
    write_json(
        folder / "station.json", {"units": "mm", "core_from_world": pose_document(station.core_from_world)}
    )
    if projector is not None:
        camera, (rows, columns) = projector.camera, projector.pattern.shape[:2]
        document = {
            "units": "mm",
            "size_px": [columns, rows],
            "focal_px": camera.focal_px,
            "center_px": camera.center_px,
            "distortion": camera.distortion,
            "projector_from_world": pose_document(projector.projector_from_world),
            "power": projector.power,
        }
        write_json(folder / "projector.json", document)


def write_belt(folder: Path, belt: BeltSettings) -> None:
    """Write belt.json."""
    document = {"units": "mm", **belt.model_dump(mode="json"), "cross_section_mm": belt.section_mm}
    write_json(folder / "belt.json", document)


def write_boards(folder: Path, station: Station, board: Board, world_from_board: Mapping[str, Pose]) -> None:
    """Write board_poses.json of a board with one pose per frame, and the rig's truth beside it."""
    write_station(folder, station, None)
    corners = corner_points_mm(board)
    frames = {}
    for frame, pose in world_from_board.items():
        points = pose.apply(corners)
        corners_in_image = {
            name: int(is_in_image(camera, station.cam_from_world(name), points).sum())
            for name, camera in station.rig.cameras.items()
        }
        frames[frame] = {
            "world_from_board": pose_document(pose),
            "core_from_board": pose_document(station.core_from_world @ pose),
            "corners_in_image": corners_in_image,
        }
    document = {"units": "mm", "board": board.model_dump(mode="json"), "frames": frames}
    write_json(folder / "board_poses.json", document)


def write_depth(path: Path, world: World, truth: CoreTruth, image: CoreView, heap: Heap | None) -> None:
    """Write the depth file of a scene, as described above."""
    rocks = {} if heap is None else {"rock": label_rocks(truth, world.solids, heap)}
    write_arrays(
        path,
        depth_mm=truth.depth_mm.astype(np.float32),
        label=truth.label,
        views=truth.views,
        lit=truth.lit,
        depth_distorted_mm=image.depth_mm.astype(np.float32),
        label_distorted=image.label,
        **rocks,
    )


def pose_document(pose: Pose) -> dict[str, Any]:
    """Return a pose in the form of rig.json."""
    return {"rotation": pose.rotation, "translation_mm": pose.translation_mm}


def _summary(world: World, truth: CoreTruth, load: TrueLoad) -> dict[str, Any]:
    labels = {solid.name: int(solid.label) for solid in world.solids}
    load_labels = sorted({label for label in labels.values() if label not in (Label.BELT, Label.FLOOR)})
    regions = {"belt": [Label.BELT], "load": load_labels, "belt+load": [Label.BELT, *load_labels]}
    return {
        "units": "mm",
        "labels": labels,
        "ceilings": {
            name: measurable_shares(truth, np.isin(truth.label, label_group))
            for name, label_group in regions.items()
            if np.isin(truth.label, label_group).any()
        },
        "volume": {
            "definition": "integral over the box of max(z seen from above - z of the empty belt, 0), vertical in "
            "the world; overhang counts as solid",
            "across_mm": list(load.across_mm),
            "along_mm": list(load.along_mm),
            "volume_mm3": load.volume_mm3,
            "spread_mm3": load.spread_mm3,
        },
    }
