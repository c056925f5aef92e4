"""Digital image correlation of subsets between two images, and the fit of the auxiliary's pose to them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from beltscape.core.frames import Image
from beltscape.core.geometry.pose import Pose, rotation_from_vector
from beltscape.core.geometry.rig import Rig

_ENDED = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-7)
"""End of the search: after 100 iterations, or when the correlation rises by less than 1e-7."""
_OUTLIER_PX = 0.1
"""Distance from the epipolar line beyond which the loss grows linearly: some ten σ of a subset's location."""
_END = 1e-12
"""Relative change that ends the fit of the pose: rounding."""
_SCALE = 1e-3
"""Scale of the pose's parameters, rad: the order of their corrections."""


def find_subsets(
    core: Image,
    auxiliary: Image,
    core_px: NDArray[np.float64],
    start_px: NDArray[np.float64],
    *,
    subset_px: int,
    reach_px: tuple[int, int],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Locate subsets around whole core pixels in the auxiliary image; return positions and correlations.

    First the best whole pixel within ``reach_px`` (u, v) of the start is taken, then an affine subset maximises the
    zero-mean correlation (ECC, Evangelidis & Psarakis 2008, doi:10.1109/TPAMI.2008.113).

    Parameters
    ----------
    core, auxiliary
        Grey images (H, W).
    core_px, start_px
        (N, 2) whole pixels of the core, and their approximate positions in the auxiliary, px.
    subset_px
        Edge of the subset, odd.
    reach_px
        Search range around the start.

    Returns
    -------
    (N, 2) px and (N,) correlation, at most 1; NaN if the subset leaves an image or the search fails.
    """
    found, score = np.full(core_px.shape, np.nan), np.full(len(core_px), np.nan)
    half = subset_px // 2
    for i, ((x, y), start) in enumerate(zip(core_px.astype(int), start_px, strict=True)):
        subset = core[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1]
        low = np.maximum(np.rint(start).astype(int) - half - reach_px, 0)
        high = np.rint(start).astype(int) + half + reach_px + 1
        window = auxiliary[low[1] : high[1], low[0] : high[0]]
        if subset.shape != (subset_px, subset_px) or min(window.shape) < subset_px:
            continue
        corner = cv2.minMaxLoc(cv2.matchTemplate(window, subset, cv2.TM_CCOEFF_NORMED))[3]
        warp = np.array([[1, 0, corner[0]], [0, 1, corner[1]]], np.float32)
        try:
            score[i], fitted = cv2.findTransformECC(
                subset, window, warp, cv2.MOTION_AFFINE, _ENDED, np.full_like(window, 255), 1
            )
        except cv2.error as error:
            if error.code != cv2.Error.StsNoConv:
                raise
            continue  # the iteration left the window
        found[i] = np.asarray(fitted) @ [half, half, 1] + low
    return found, score


def fit_auxiliary_pose(rig: Rig, core_px: NDArray[np.float64], aux_px: NDArray[np.float64]) -> Rig:
    """Return the rig of two cameras with the auxiliary's pose fitted to correspondences (N, 2).

    Rotation and direction of the baseline minimise the distances from the epipolar lines, robustly (soft L1 beyond
    0.1 px); intrinsics and the baseline's length are kept.
    """
    name = rig.auxiliaries[0]
    old, aux = rig.cam_from_core[name], rig.cameras[name]
    length = float(np.linalg.norm(old.translation_mm))
    first, second = (np.column_stack([c.undistort(p), np.ones(len(p))])
                     for c, p in ((rig.core_camera, core_px), (aux, aux_px)))  # fmt: skip
    _, _, across = np.linalg.svd(old.translation_mm[None])

    def pose(x: NDArray[np.float64]) -> Pose:
        direction = old.translation_mm / length + x[3:] @ across[1:]
        return Pose(
            rotation_from_vector(x[:3]) @ old.rotation, length * direction / np.linalg.norm(direction)
        )

    def off_px(x: NDArray[np.float64]) -> NDArray[np.float64]:
        at = pose(x)
        lines = np.cross(at.translation_mm / length, first @ at.rotation.T)
        return (second * lines).sum(axis=1) / np.hypot(lines[:, 0], lines[:, 1]) * aux.focal_px.mean()

    fit = optimize.least_squares(
        off_px, np.zeros(5), x_scale=_SCALE, loss="soft_l1", f_scale=_OUTLIER_PX, xtol=_END, ftol=_END
    )
    return replace(rig, cam_from_core={rig.core: Pose.identity(), name: pose(fit.x)})
