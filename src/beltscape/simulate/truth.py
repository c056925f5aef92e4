"""What the core camera truly has before it: depth, labels, and who else sees each of its pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera
from beltscape.core.pose import Pose
from beltscape.simulate.heap import Heap
from beltscape.simulate.sight import in_image, pixel_rays
from beltscape.simulate.trace import RayScene
from beltscape.simulate.world import Label, Projector, Solid, Station, World


@dataclass(frozen=True, slots=True, eq=False)
class CoreTruth:
    """The truth on one of the core camera's grids of H × W pixels."""

    depth_mm: NDArray[np.float64]
    """(H, W) along the optical axis, exact to 1e-6 mm; NaN where there is nothing."""
    label: NDArray[np.uint8]
    """(H, W) `Label`."""
    solid: NDArray[np.int64]
    """(H, W) index of the world's solid; -1 where there is nothing."""
    face: NDArray[np.int64]
    """(H, W) index of the face within its solid; -1 where there is nothing."""
    seen: Mapping[str, NDArray[np.bool_]]
    """By auxiliary camera: (H, W), whether the pixel's point is in its image and not hidden."""
    lit: NDArray[np.bool_]
    """(H, W) whether the projector's pattern reaches the point; nowhere without a projector."""

    @property
    def views(self) -> NDArray[np.uint8]:
        """(H, W) how many auxiliaries see the point."""
        views = np.zeros(self.label.shape, np.uint8)
        for seen in self.seen.values():
            views += seen
        return views


def core_truth(
    world: World, station: Station, *, distorted: bool = False, scene: RayScene | None = None
) -> CoreTruth:
    """Trace the core camera's undistorted pinhole grid, or its image as it is taken.

    ``scene`` saves the building of the world's ray scene where there is one already.
    """
    scene = scene or RayScene(world.solids)
    camera, pose = station.rig.core_camera, station.core_from_world
    rays = pixel_rays(camera, pose, distorted=distorted)
    hits = scene.hits(pose.center_mm, rays)
    met = hits.face >= 0
    surface = _Surface(scene, pose.center_mm + hits.distance[met, None] * rays[met], hits.face[met])
    shape = camera.size_px[::-1]
    solid = scene.solid_of_face[surface.face]

    def spread(values: NDArray[Any], empty: float) -> NDArray[Any]:
        whole = np.full(len(rays), empty, values.dtype)
        whole[met] = values
        return whole.reshape(shape)

    return CoreTruth(
        depth_mm=spread(hits.distance[met], np.nan),
        label=spread(scene.label_of_face[surface.face], Label.NOTHING),
        solid=spread(solid, -1),
        face=spread(surface.face - scene.first_face[solid], -1),
        seen={
            name: spread(surface.seen_by(station.rig.cameras[name], station.cam_from_world(name)), False)
            for name in station.rig.auxiliaries
        },
        lit=spread(surface.lit_by(world.projector), False),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """The places that the core's rays met."""

    scene: RayScene
    points_mm: NDArray[np.float64]
    """(N, 3)."""
    face: NDArray[np.int64]
    """(N,)."""

    def seen_by(self, camera: Camera, cam_from_world: Pose) -> NDArray[np.bool_]:
        """(N,) whether they are in the camera's image and not hidden."""
        inside = in_image(camera, cam_from_world, self.points_mm)
        normals = self.scene.normals(self.face[inside])
        inside[inside] = self.scene.visible_from(self.points_mm[inside], normals, cam_from_world.center_mm)
        return inside

    def lit_by(self, projector: Projector | None) -> NDArray[np.bool_]:
        """(N,) whether the pattern reaches them."""
        if projector is None:
            return np.zeros(len(self.face), bool)
        return self.seen_by(pattern_camera(projector), projector.projector_from_world)


def pattern_camera(projector: Projector) -> Camera:
    """The projector as a camera as large as its pattern."""
    camera, (rows, columns) = projector.camera, projector.pattern.shape[:2]
    return Camera(camera.name, (columns, rows), camera.focal_px, camera.center_px, camera.distortion)


def ceilings(truth: CoreTruth, region: NDArray[np.bool_]) -> dict[str, float]:
    """Shares (0..1) of a region's pixels (H, W) that can be measured at all: lit, seen, lit and seen by so many."""
    count = max(int(region.sum()), 1)
    lit, views = truth.lit[region], truth.views[region]
    shares = {"pixels": float(region.sum()), "lit": float(lit.sum() / count)}
    shares |= {f"seen_{name}": float(seen[region].sum() / count) for name, seen in truth.seen.items()}
    for number in range(1, len(truth.seen) + 1):
        shares[f"seen_by_{number}"] = float((views >= number).sum() / count)
        shares[f"lit_and_seen_by_{number}"] = float((lit & (views >= number)).sum() / count)
    return shares


def rock_of_pixel(truth: CoreTruth, solids: tuple[Solid, ...], heap: Heap) -> NDArray[np.int32]:
    """(H, W) number of the heap's rock that a pixel shows, -1 where it shows none."""
    which = [i for i, solid in enumerate(solids) if solid.name == "rocks"]
    rock = np.searchsorted(heap.rocks.first_face, truth.face, side="right") - 1
    return np.where(np.isin(truth.solid, which), rock, -1).astype(np.int32)
