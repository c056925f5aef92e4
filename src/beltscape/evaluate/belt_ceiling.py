"""The ceiling of the fused belt: what of a simulated heap any frame could measure, by true rays.

A point of the surface seen from straight above counts as measurable where, in one frame, the core camera and an
auxiliary see it and the projector's pattern reaches it. No fusion of depth maps on the core's grid measures more.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from beltscape.core.errors import InputError
from beltscape.core.geometry.pose import Pose
from beltscape.files.json_text import read_json
from beltscape.simulate.core_truth import is_in_image, make_pattern_camera
from beltscape.simulate.ray_casting import RayScene
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.scene_assembly import SimulatedScene
from beltscape.simulate.world import Label, Projector, Station

Points = NDArray[np.float64]
"""(N, 3) in the world, mm."""


def read_moving_scene(truth: Path) -> SimulatedScene | None:
    """Return the scene of a truth folder of a moving belt; None for a truth that was not simulated here.

    Raises
    ------
    InputError
        If its scenario.json cannot be read.
    """
    path = truth / "scenario.json"
    if not path.is_file():
        return None
    try:
        return SimulatedScene(Scenario.model_validate(read_json(path)))
    except ValidationError as error:
        raise InputError(f"{path}: is no scenario of this program; simulate the scene again") from error


class MovingCeiling:
    """Finds which points of a moving heap some frame could measure; the heap rests, and the devices move by it."""

    def __init__(self, scene: SimulatedScene) -> None:
        heap = () if scene.heap is None else scene.heap.solids
        self._scene = scene
        self._rays = RayScene([*(one for one in scene.belt if one.label == Label.BELT), *heap])
        self._heap_mm = {
            scene.frame_name(frame): scene.heap_position_mm(frame) for frame in range(scene.frame_count)
        }

    def find_measurable(
        self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64], frames: tuple[str, ...]
    ) -> NDArray[np.bool_]:
        """Return (N,) whether one of the frames could measure the surface at x of the world and y of the heap.

        Nothing is measurable without a projector.
        """
        points, normals = self._trace_top(x_mm, y_mm)
        result = np.zeros(len(points), bool)
        for frame in frames:
            missing = np.flatnonzero(~result & np.isfinite(normals).all(axis=1))
            result[missing] = self._is_measurable(points[missing], normals[missing], self._heap_mm[frame])
        return result

    def _trace_top(self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> tuple[Points, Points]:
        """Return the points of the surface below vertical rays, and their outward normals, NaN without one."""
        high = float(self._rays.corners_mm[..., 2].max()) + 1.0
        points = np.column_stack([x_mm, y_mm, np.full(len(x_mm), high)])
        hits = self._rays.cast(points, np.broadcast_to(np.array([0.0, 0.0, -1.0]), points.shape))
        points[:, 2] -= hits.distance
        return points, self._rays.face_normals(hits.face)

    def _is_measurable(self, points: Points, normals: Points, heap_mm: float) -> NDArray[np.bool_]:
        """Return (N,) whether the points are measurable in the frame with the heap at this position."""
        world_from_heap = Pose.of(np.eye(3), (0.0, heap_mm, 0.0))
        station, projector = self._scene.station, self._scene.projector
        if projector is None:
            return np.zeros(len(points), bool)
        station = replace(station, core_from_world=station.core_from_world @ world_from_heap)
        projector = replace(projector, projector_from_world=projector.projector_from_world @ world_from_heap)
        result = self._sees(points, normals, station, station.rig.core)
        result[result] = self._lights(points[result], normals[result], projector)
        open_points = np.flatnonzero(result)
        result[:] = False
        for name in station.rig.auxiliaries:
            seen = self._sees(points[open_points], normals[open_points], station, name)
            result[open_points[seen]] = True
            open_points = open_points[~seen]
        return result

    def _sees(self, points: Points, normals: Points, station: Station, name: str) -> NDArray[np.bool_]:
        """Return (N,) whether a camera sees the points."""
        pose = station.cam_from_world(name)
        seen = is_in_image(station.rig.cameras[name], pose, points)
        seen[seen] = self._rays.is_visible_from(points[seen], normals[seen], pose.center_mm)
        return seen

    def _lights(self, points: Points, normals: Points, projector: Projector) -> NDArray[np.bool_]:
        """Return (N,) whether the pattern reaches the points."""
        pose = projector.projector_from_world
        lit = is_in_image(make_pattern_camera(projector), pose, points)
        lit[lit] = self._rays.is_visible_from(points[lit], normals[lit], pose.center_mm)
        return lit
