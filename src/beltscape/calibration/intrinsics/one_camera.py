"""The bundle adjustment of one camera: its lens and the poses of the boards that it sees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import Corners
from beltscape.calibration.solver.bundle import Bundle
from beltscape.calibration.solver.bundle_data import BundlePrior, Geometry, Observations
from beltscape.calibration.solver.lens import list_parameters, pack_intrinsics
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose

Array = NDArray[np.float64]


def set_up_adjustment(
    views: Mapping[str, Corners],
    camera: Camera,
    poses: Sequence[Pose],
    board_mm: Array,
    *,
    prior: tuple[Array, Array] | None = None,
    fixed: tuple[str, ...] = (),
    sigma_px: float = 1.0,
) -> tuple[Bundle, Geometry]:
    """Return the adjustment of a camera's lens and of the board's pose in each of its views, and its start.

    Parameters
    ----------
    poses
        cam_from_board of the views, in their order.
    prior
        Mean (W,) and information (W, W) of the intrinsics; None: no prior knowledge.
    fixed
        Parameters that keep their values.
    sigma_px
        One standard deviation of a corner's coordinate.
    """
    row = pack_intrinsics(camera)
    mean, information = prior or (row, np.zeros((len(row), len(row))))
    free = np.array([name not in fixed for name in list_parameters(camera.model)])
    known = BundlePrior((camera.model,), mean[None], information[None], free[None], board_mm, np.zeros(3))
    rotations, shifts = [pose.rotation for pose in poses], [pose.translation_mm for pose in poses]
    identity = np.eye(3)[None], np.zeros((1, 3))
    state = Geometry(row[None], *identity, np.stack(rotations), np.stack(shifts), board_mm)
    observed = Observations.from_views((0, i, c.ids, c.pixels) for i, c in enumerate(views.values()))
    return Bundle(replace(observed, sigma_px=np.full(len(observed.pixels), sigma_px)), known), state
