"""The truth of the core camera: depth, labels, and the visibility of each pixel from the other devices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.simulate.ray_casting import RayScene
from beltscape.simulate.solids.heap import Heap
from beltscape.simulate.world import Label, Projector, Solid, Station, World


def compute_pixel_rays(camera: Camera, cam_from_world: Pose, *, distorted: bool) -> NDArray[np.float64]:
    """Return (H·W, 3) rays of all pixels, row by row, in the world, one millimetre long along the optical axis.

    A distance in lengths of such a ray is a depth in mm. ``distorted``: through the pixels of the image as the camera
    records it; else of its undistorted pinhole grid. NaN where the lens model has no ray.
    """
    if distorted:
        width, height = camera.size_px
        u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        plane = camera.undistort(np.stack([u, v], axis=-1).reshape(-1, 2))
    else:
        plane = camera.rays().reshape(-1, 2)
    return np.column_stack([plane, np.ones(len(plane))]) @ cam_from_world.rotation


def is_in_image(camera: Camera, cam_from_world: Pose, points_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return (N,) whether world points (N, 3) project into the image: in front of the camera and on a pixel."""
    points = cam_from_world.apply(points_mm)
    pixels = camera.project(points)
    with np.errstate(invalid="ignore"):
        is_inside = np.all((pixels >= -0.5) & (pixels < np.array(camera.size_px) - 0.5), axis=1)
    # far outside the view the lens polynomial turns back and projects points into the image that no lens images
    ideal = points[is_inside, :2] / points[is_inside, 2:]
    undistorted = camera.undistort(pixels[is_inside])
    is_inside[is_inside] = (np.abs(undistorted - ideal) < 1e-6).all(axis=1)
    return is_inside


@dataclass(frozen=True, slots=True, eq=False)
class CoreView:
    """The scene in the core camera, on one of its grids of H × W pixels."""

    depth_mm: NDArray[np.float64]
    """(H, W) along the optical axis, exact to 1e-6 mm; NaN where there is no surface."""
    label: NDArray[np.uint8]
    """(H, W) `Label`."""
    solid: NDArray[np.int64]
    """(H, W) index of the world's solid; -1 where there is no surface."""
    face: NDArray[np.int64]
    """(H, W) index of the face within its solid; -1 where there is no surface."""


@dataclass(frozen=True, slots=True, eq=False)
class CoreTruth(CoreView):
    """A `CoreView` with the visibility of its points from auxiliaries and projector."""

    seen: Mapping[str, NDArray[np.bool_]]
    """By auxiliary camera: (H, W), whether the pixel's point is in its image and not hidden."""
    lit: NDArray[np.bool_]
    """(H, W) whether the projector's pattern reaches the point; nowhere without a projector."""

    @property
    def views(self) -> NDArray[np.uint8]:
        """Return (H, W) the number of auxiliaries that see the point."""
        views = np.zeros(self.label.shape, np.uint8)
        for seen in self.seen.values():
            views += seen
        return views


def trace_core_view(
    world: World, station: Station, *, distorted: bool = False, scene: RayScene | None = None
) -> CoreView:
    """Trace the core camera's undistorted pinhole grid, or (``distorted``) its recorded image.

    ``scene`` is the world's ray scene where it exists already.
    """
    scene = scene or RayScene(world.solids)
    camera, pose = station.rig.core_camera, station.core_from_world
    return _SurfacePoints.trace(
        scene, pose.center_mm, compute_pixel_rays(camera, pose, distorted=distorted)
    ).view(camera)


def trace_core_truth(
    world: World, station: Station, *, distorted: bool = False, scene: RayScene | None = None
) -> CoreTruth:
    """Trace `CoreTruth`: the core view, and the visibility of its points from the auxiliaries and the projector."""
    scene = scene or RayScene(world.solids)
    camera, pose = station.rig.core_camera, station.core_from_world
    surface = _SurfacePoints.trace(
        scene, pose.center_mm, compute_pixel_rays(camera, pose, distorted=distorted)
    )
    view = surface.view(camera)
    seen = {
        name: surface.is_visible_in(station.rig.cameras[name], station.cam_from_world(name))
        for name in station.rig.auxiliaries
    }
    shape = view.label.shape
    return CoreTruth(
        depth_mm=view.depth_mm,
        label=view.label,
        solid=view.solid,
        face=view.face,
        seen={name: surface.scatter_to_rays(is_seen, False).reshape(shape) for name, is_seen in seen.items()},
        lit=surface.scatter_to_rays(surface.is_lit_by(world.projector), False).reshape(shape),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _SurfacePoints:
    """The surface points that rays hit."""

    scene: RayScene
    hit: NDArray[np.bool_]
    """(R,) which of the rays hit a surface: N of them."""
    depth_mm: NDArray[np.float64]
    """(N,)."""
    points_mm: NDArray[np.float64]
    """(N, 3)."""
    face: NDArray[np.int64]
    """(N,)."""

    @classmethod
    def trace(cls, scene: RayScene, eye_mm: NDArray[np.float64], rays: NDArray[np.float64]) -> _SurfacePoints:
        """Trace rays (R, 3) from an eye (3,)."""
        hits = scene.cast(eye_mm, rays)
        hit = hits.face >= 0
        depth = hits.distance[hit]
        return cls(scene, hit, depth, eye_mm + depth[:, None] * rays[hit], hits.face[hit])

    def scatter_to_rays(self, values: NDArray[Any], empty: float) -> NDArray[Any]:
        """Return (R,) values (N,) at the indices of their rays."""
        whole = np.full(len(self.hit), empty, values.dtype)
        whole[self.hit] = values
        return whole

    def view(self, camera: Camera) -> CoreView:
        """Return the points on the grid of the camera that the rays belong to."""
        shape = camera.size_px[::-1]
        solid = self.scene.solid_of_face[self.face]
        return CoreView(
            depth_mm=self.scatter_to_rays(self.depth_mm, np.nan).reshape(shape),
            label=self.scatter_to_rays(self.scene.label_of_face[self.face], Label.NOTHING).reshape(shape),
            solid=self.scatter_to_rays(solid, -1).reshape(shape),
            face=self.scatter_to_rays(self.face - self.scene.first_face[solid], -1).reshape(shape),
        )

    def is_visible_in(self, camera: Camera, cam_from_world: Pose) -> NDArray[np.bool_]:
        """Return (N,) whether the points are in the camera's image and not hidden."""
        is_visible = is_in_image(camera, cam_from_world, self.points_mm)
        normals = self.scene.face_normals(self.face[is_visible])
        is_visible[is_visible] = self.scene.is_visible_from(
            self.points_mm[is_visible], normals, cam_from_world.center_mm
        )
        return is_visible

    def is_lit_by(self, projector: Projector | None) -> NDArray[np.bool_]:
        """Return (N,) whether the pattern reaches the points."""
        if projector is None:
            return np.zeros(len(self.face), bool)
        return self.is_visible_in(make_pattern_camera(projector), projector.projector_from_world)


def make_pattern_camera(projector: Projector) -> Camera:
    """Return the projector as a camera with the size of its pattern."""
    camera, (rows, columns) = projector.camera, projector.pattern.shape[:2]
    return Camera(camera.name, (columns, rows), camera.focal_px, camera.center_px, camera.distortion)


def measurable_shares(truth: CoreTruth, region: NDArray[np.bool_]) -> dict[str, float]:
    """Return the shares (0..1) of a region's pixels (H, W) that are lit, seen, and both by at least n auxiliaries."""
    count = max(int(region.sum()), 1)
    lit, views = truth.lit[region], truth.views[region]
    shares = {"pixels": float(region.sum()), "lit": float(lit.sum() / count)}
    shares |= {f"seen_{name}": float(seen[region].sum() / count) for name, seen in truth.seen.items()}
    for number in range(1, len(truth.seen) + 1):
        shares[f"seen_by_{number}"] = float((views >= number).sum() / count)
        shares[f"lit_and_seen_by_{number}"] = float((lit & (views >= number)).sum() / count)
    return shares


def label_rocks(truth: CoreView, solids: tuple[Solid, ...], heap: Heap) -> NDArray[np.int32]:
    """Return (H, W) the index of the heap's rock in each pixel, -1 where there is none."""
    return index_rocks(truth.solid, truth.face, solids, heap)


def index_rocks(
    solid: NDArray[np.int64], face: NDArray[np.int64], solids: tuple[Solid, ...], heap: Heap
) -> NDArray[np.int32]:
    """Return the index of the heap's rock, -1: none, by the index of the solid and of the face within it."""
    rock_solids = [i for i, one in enumerate(solids) if one.name == "rocks"]
    rock = np.searchsorted(heap.rocks.first_face, face, side="right") - 1
    return np.where(np.isin(solid, rock_solids), rock, -1).astype(np.int32)
