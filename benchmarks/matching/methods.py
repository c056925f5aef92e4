"""The compared matching methods, prepared for a scene, a depth range and a number of threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.progress import Silent
from beltscape.evaluate.depth_scores import GROSS_MM, DepthScore, interior_mask, score_depth
from beltscape.evaluate.frame_scores import compute_false_fill, compute_pixel_locking, compute_sigma_ratios
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.pairwise.reconstructor import PairwiseReconstructor, find_horizontal_auxiliary
from beltscape.stereo.pairwise.rectification import rectify_pair
from beltscape.stereo.settings import MultiviewSettings, PairwiseSettings
from captures import Scene
from timing import Cost, measure_cost

Range = tuple[float, float]
"""(near, far), mm."""

MULTIVIEW = ("fast", "standard")
METHODS = (*MULTIVIEW, "pairwise", "binocular")
HH = "SGBM, 8 directions (HH)"
SGBM = {"SGBM, 5 directions": cv2.StereoSGBM_MODE_SGBM, HH: cv2.StereoSGBM_MODE_HH}
_LOCKED_LEAST = 2000
"""Smallest number of interior pixels for which pixel locking is evaluated."""


@dataclass(frozen=True)
class Result:
    """The result of a method on a scene."""

    depth: DepthMap
    score: DepthScore
    false_fill: float
    sigma_ratios: tuple[float, float]
    """Actual over predicted σ, smallest and largest over the quintiles of predicted σ."""
    locking_px: float
    cost: Cost | None


def run(method: str, scene: Scene, near_far: Range, *, timed: bool = True) -> Result:
    """Match and score a scene; call it in a fresh process to measure memory."""
    if timed:
        depth, spent = measure_cost(lambda threads: make_matcher(method, scene, near_far, threads))
    else:
        depth, spent = make_matcher(method, scene, near_far, 0)(), None
    dz, where = find_interior_errors(depth, scene)
    ratios = compute_sigma_ratios(dz, depth.sigma_mm[where])
    return Result(
        depth=depth,
        score=score_depth(depth, scene.true_depth_mm, scene.region),
        false_fill=compute_false_fill(depth, scene.occluded),
        sigma_ratios=(float(ratios.min()), float(ratios.max())),
        locking_px=_locking(method, scene, near_far, depth, where),
        cost=spent,
    )


def make_matcher(method: str, scene: Scene, near_far: Range, threads: int) -> Callable[[], DepthMap]:
    """Return a function that matches the scene with a prepared matcher."""
    if method in MULTIVIEW:
        settings = MultiviewSettings.preset(method).model_copy(update={"threads": threads})
        made = MultiviewReconstructor(scene.rig, near_far, settings)
    else:
        names = scene.rig.auxiliaries if method == "pairwise" else (find_horizontal_auxiliary(scene.rig),)
        made = PairwiseReconstructor(
            scene.rig, near_far, PairwiseSettings(threads=threads), auxiliaries=names
        )
    return lambda: made.reconstruct(scene.frame, Silent())


def bare_sgbm(name: str, scene: Scene, near_far: Range) -> Cost:
    """Return the cost of one OpenCV SGBM call per rectified pair, with the pairs in parallel threads."""
    jobs = []
    for auxiliary in scene.rig.auxiliaries:
        pair = rectify_pair(scene.rig, auxiliary, near_far)
        left = cv2.remap(scene.frame.images[scene.rig.core], pair.core_map, None, cv2.INTER_LINEAR)
        right = cv2.remap(scene.frame.images[auxiliary], pair.aux_map, None, cv2.INTER_LINEAR)
        grey = [cv2.cvtColor(i, cv2.COLOR_RGB2GRAY) if i.ndim == 3 else i for i in (left, right)]
        jobs.append((pair.disparities, *grey))

    def make(threads: int) -> Callable[[], object]:
        def one(job: tuple[int, np.ndarray, np.ndarray]) -> np.ndarray:
            sgbm = cv2.StereoSGBM_create(0, job[0], 5, 200, 800, mode=SGBM[name])
            return sgbm.compute(job[1], job[2])

        def work() -> object:
            with ThreadPoolExecutor(threads) as pool:
                return list(pool.map(one, jobs))

        return work

    return measure_cost(make)[1]


def find_interior_errors(depth: DepthMap, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors (N,), mm, of interior measured pixels without gross errors, and their mask (H, W)."""
    error = depth.depth_mm.astype(np.float64) - scene.true_depth_mm
    where = scene.region & interior_mask(scene.true_depth_mm)
    where &= np.isfinite(error) & (np.abs(np.nan_to_num(error)) < GROSS_MM)
    return error[where], where


def _locking(method: str, scene: Scene, near_far: Range, depth: DepthMap, where: np.ndarray) -> float:
    if where.sum() < _LOCKED_LEAST:
        return np.nan
    measured, true = (
        _disparity_px(method, scene, near_far, z.astype(np.float64), where)
        for z in (depth.depth_mm, scene.true_depth_mm)
    )
    return compute_pixel_locking(measured, true)


def _disparity_px(
    method: str, scene: Scene, near_far: Range, depth_mm: np.ndarray, where: np.ndarray
) -> np.ndarray:
    """Return the disparities (N,) of the most horizontal pair in the matched (for pairwise, rectified) images."""
    rig, name = scene.rig, find_horizontal_auxiliary(scene.rig)
    rays, z = rig.core_camera.rays()[where], depth_mm[where]
    if method in MULTIVIEW:
        points = np.concatenate([rays * z[:, None], z[:, None]], axis=-1)
        return rig.cameras[name].project(rig.cam_from_core[name].apply(points))[:, 0]
    sampling = PairwiseSettings().choose_oversampling(rig.core_camera.size_px[0])
    pair = rectify_pair(rig, name, near_far, oversampling=sampling)
    return pair.disparity_from_depth(z * pair.project_core_rays(rays)[1])
