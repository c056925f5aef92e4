"""Bundle adjustment problems with a known solution."""

from __future__ import annotations

import numpy as np

from beltscape.calibration.solver.bundle import Geometry, Observations
from beltscape.calibration.solver.lens import pack_intrinsics
from beltscape.calibration.solver.prior import BundlePrior
from beltscape.target.board import corner_points_mm
from tests.synthetic.detections import make_detections


def make_problem(rig, board, poses, noise_px=0.0, seed=0, *, points_mm=None, points_sigma_mm=0.0):
    """Return noisy observations, the true geometry, and a prior that leaves all parameters but k3 free."""
    nominal = corner_points_mm(board)
    true_points = nominal if points_mm is None else points_mm
    rng = np.random.default_rng(seed)
    rows = []
    seen = make_detections(rig, board, poses)
    for frame, pose in enumerate(poses):
        for index, (name, camera) in enumerate(rig.cameras.items()):
            corners = seen.views[name].get(f"{frame:02d}")
            if corners is not None:
                pixels = camera.project((rig.cam_from_core[name] @ pose).apply(true_points[corners.ids]))
                pixels = pixels + rng.normal(0, noise_px, pixels.shape)
                count = len(corners)
                rows.append((np.full(count, index), np.full(count, frame), corners.ids, pixels))
    camera, frame, point, pixels = (np.concatenate(column) for column in zip(*rows, strict=True))
    sigma = np.full(len(pixels), max(noise_px, 1.0 if noise_px == 0 else noise_px))
    geometry = Geometry(
        np.stack([pack_intrinsics(camera) for camera in rig.cameras.values()]),
        np.stack([rig.cam_from_core[name].rotation for name in rig.cameras]),
        np.stack([rig.cam_from_core[name].translation_mm for name in rig.cameras]),
        np.stack([pose.rotation for pose in poses]),
        np.stack([pose.translation_mm for pose in poses]),
        true_points,
    )
    cameras = len(rig.cameras)
    free = np.ones((cameras, 9), bool)
    free[:, 8] = False
    prior = BundlePrior(
        ("brown",) * cameras,
        geometry.intrinsics,
        np.zeros((cameras, 9, 9)),
        free,
        nominal,
        np.full(3, points_sigma_mm),
    )
    return Observations(camera, frame, point, pixels, sigma), geometry, prior
