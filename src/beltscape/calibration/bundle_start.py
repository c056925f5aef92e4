"""Start of the bundle adjustment: observations, geometry and prior from the hierarchy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import HierarchyResult
from beltscape.calibration.intrinsics.zhang import MonocularCalibration
from beltscape.calibration.solver.bundle import Bundle
from beltscape.calibration.solver.bundle_data import BundlePrior, Geometry, Indices, Observations
from beltscape.calibration.solver.lens import compute_lens_prior, list_parameters, pad_rows, stack_intrinsics
from beltscape.calibration.solver.levenberg_marquardt import Damping, minimise
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig

Array = NDArray[np.float64]

SHAPE_SIGMA_SHARE = 0.002
"""Prior standard deviation of a corner about its nominal position, over the board's diagonal."""


def collect_observations(
    hierarchy: HierarchyResult, detections: BoardDetections, names: tuple[str, ...]
) -> tuple[tuple[str, ...], Observations]:
    """Return the frames and corners of some cameras, which are numbered in the given order."""
    frames: list[str] = []
    views: list[tuple[int, int, Indices, Array]] = []
    for frame in detections.frames:
        seeing = [
            name for name in names if frame in detections.views[name] and _is_used(hierarchy, name, frame)
        ]
        for name in seeing:
            corners = detections.views[name][frame]
            views.append((names.index(name), len(frames), corners.ids, corners.pixels))
        if seeing:
            frames.append(frame)
    return tuple(frames), Observations.from_views(views)


def _is_used(hierarchy: HierarchyResult, name: str, frame: str) -> bool:
    return frame not in hierarchy.monocular[name].rejected


def initialise_geometry(
    hierarchy: HierarchyResult, observations: Observations, frames: Sequence[str], board_mm: Array
) -> Geometry:
    """Return the hierarchy's rig with the boards at the poses that all cameras together give."""
    rig = hierarchy.rig
    boards = [_find_board_pose(hierarchy, frame) for frame in frames]
    start = Geometry(
        intrinsics=stack_intrinsics(rig.cameras.values()),
        cam_rotation=np.stack([rig.cam_from_core[name].rotation for name in rig.cameras]),
        cam_translation_mm=np.stack([rig.cam_from_core[name].translation_mm for name in rig.cameras]),
        board_rotation=np.stack([pose.rotation for pose in boards]),
        board_translation_mm=np.stack([pose.translation_mm for pose in boards]),
        points_mm=board_mm,
    )
    return minimise(Bundle(observations, _fix_rig(rig, board_mm)), start, Damping(tolerance=1e-6)).state


def _find_board_pose(hierarchy: HierarchyResult, frame: str) -> Pose:
    """Return core_from_board of a frame by the camera that sees the most corners."""
    name = max(
        (name for name in hierarchy.rig.cameras if frame in hierarchy.monocular[name].cam_from_board),
        key=lambda name: len(hierarchy.detections.views[name][frame]),
    )
    seen = hierarchy.monocular[name].cam_from_board[frame]
    return hierarchy.rig.cam_from_core[name].inverse() @ seen


def _fix_rig(rig: Rig, board_mm: Array) -> BundlePrior:
    """Return the prior that leaves only the board's poses free."""
    models = tuple(camera.model for camera in rig.cameras.values())
    lenses = stack_intrinsics(rig.cameras.values())
    cameras, width = lenses.shape
    free, information = np.zeros((cameras, width), bool), np.zeros((cameras, width, width))
    poses = tuple(range(cameras))
    return BundlePrior(models, lenses, information, free, board_mm, np.zeros(3), poses)


def get_monocular_sigma(hierarchy: HierarchyResult) -> Array:
    """Return the noise (C,) of a corner's coordinate, px, that each camera alone has."""
    return np.array([hierarchy.monocular[name].rms_px / np.sqrt(2) for name in hierarchy.rig.cameras])


def make_prior(hierarchy: HierarchyResult, board_mm: Array) -> BundlePrior:
    """Return the prior of lenses and board: given lenses, lenses in general, and the board's drawing."""
    cameras = hierarchy.rig.cameras
    priors = [_find_lens_prior(hierarchy.monocular[name], camera) for name, camera in cameras.items()]
    free = [
        np.array([each not in hierarchy.monocular[name].fixed for each in list_parameters(camera.model)])
        for name, camera in cameras.items()
    ]
    diagonal = float(np.linalg.norm(np.ptp(board_mm, axis=0)))
    return BundlePrior(
        tuple(camera.model for camera in cameras.values()), pad_rows(mean for mean, _ in priors),
        pad_rows(information for _, information in priors), pad_rows(free),
        board_mm, np.full(3, SHAPE_SIGMA_SHARE * diagonal),
        tuple(i for i, name in enumerate(cameras) if name in hierarchy.fixed_poses),
    )  # fmt: skip


def _find_lens_prior(monocular: MonocularCalibration, camera: Camera) -> tuple[Array, Array]:
    """Return mean and information of a camera's intrinsics: of an earlier calibration, or of lenses in general."""
    return monocular.prior.compute_information() if monocular.prior else compute_lens_prior(camera)
