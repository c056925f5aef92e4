"""The paper's method: each auxiliary is matched with the core separately; depths are averaged (2.3, Eqs. 21-25).

The arithmetic mean is taken over the pairs that agree (Eq. 24). Its standard deviation is estimated from the pairs'
scatter, in px of rectified disparity, in which SGBM's errors do not depend on the distance.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.arguments import require_depth_range
from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.core.system_calls import count_usable_cores
from beltscape.stereo.cameras import check_auxiliaries, list_usable_auxiliaries
from beltscape.stereo.multiview.depth_range import find_depth_range
from beltscape.stereo.pairwise.rectification import take_square_root
from beltscape.stereo.pairwise.sgbm import PairMatcher, make_pair_matcher
from beltscape.stereo.settings import PairwiseSettings

_STRIP_ROWS = 64
"""Rows that are fused at a time, so that they stay in the cache."""


@dataclass(frozen=True, slots=True, eq=False)
class FusedDepth:
    """The mean over the pairs, and their scatter."""

    depth_mm: NDArray[np.float32]
    """(H, W) float32, NaN where no pair measured or no two pairs agree."""
    views: NDArray[np.uint8]
    """(H, W) uint8: number of pairs in the mean."""
    scatter_mm2: NDArray[np.float32]
    """(H, W) float32: sum of their squared deviations from the mean."""


def fuse_depths(depths_mm: NDArray[np.float32], agreement: float | None) -> FusedDepth:
    """Return the mean over the pairs that agree.

    Parameters
    ----------
    depths_mm
        (n, H, W) float32, NaN where a pair did not measure.
    agreement
        Largest difference of agreeing depths, divided by Z²: a difference of inverse depth, 1/mm. The largest
        agreeing group is averaged, among equals the closest. Where no two of several pairs agree, the depth is
        NaN. With None all pairs are averaged, as in Eq. 24.

    References
    ----------
    Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, Eq. 24.
    """
    count, height, width = depths_mm.shape
    depth = np.empty((height, width), np.float32)
    views = np.empty((height, width), np.uint8)
    scatter = np.empty((height, width), np.float32)
    for top in range(0, height, _STRIP_ROWS):
        rows = slice(top, top + _STRIP_ROWS)
        strip = np.sort(depths_mm[:, rows].astype(np.float64), axis=0)  # NaN is last
        keep = (
            np.isfinite(strip) if agreement is None or count == 1 else _mask_largest_group(strip, agreement)
        )
        number = keep.sum(axis=0)
        values = np.where(keep, strip, 0.0)
        with np.errstate(invalid="ignore"):
            mean = values.sum(axis=0) / number
        depth[rows], views[rows] = mean, number
        scatter[rows] = np.where(keep, (strip - mean) ** 2, 0.0).sum(axis=0)
    return FusedDepth(depth, views, scatter)


def _mask_largest_group(ordered: NDArray[np.float64], agreement: float) -> NDArray[np.bool_]:
    """Return (n, H, W) bool: the largest agreeing group of values sorted along axis 0."""
    count = len(ordered)
    best_votes = np.zeros(ordered.shape[1:], np.int64)
    best_width = np.full(ordered.shape[1:], np.inf)
    first = np.zeros(ordered.shape[1:], np.int64)
    for i in range(count):
        limit = ordered[i] + agreement * ordered[i] ** 2
        inside = ordered[i:] <= limit
        votes = inside.sum(axis=0)
        width = np.where(inside, ordered[i:] - ordered[i], 0.0).max(axis=0)
        better = (votes > best_votes) | ((votes == best_votes) & (votes > 1) & (width < best_width))
        best_votes, best_width = np.where(better, votes, best_votes), np.where(better, width, best_width)
        first = np.where(better, i, first)
    measured = np.isfinite(ordered).sum(axis=0)
    accepted = (best_votes > 1) | (measured == 1)
    index = np.arange(count)[:, None, None]
    return accepted & (index >= first) & (index < first + best_votes)


_WINDOW_PX = 11
"""Edge of the window over which the spread between pairs is pooled."""
_FLOOR_PX = 0.09
"""Standard deviation of one pair on a smooth, well lit surface, from SGBM's pixel locking and steps of 1/16 px."""
_SHARED = 0.4
"""Share of the variance beyond the floor that is common to all pairs, because all smooth the shape."""
_SHARED_RELIEF = 0.2
"""Upper bound of the common variance over that of the relief; noise on a smooth surface is not common."""
_CORRELATION = -0.05
"""Correlation of two pairs' errors on a smooth surface; pixel locking of opposite auxiliaries has opposite signs."""
_ROUGHNESS = 0.5
"""Error of one pair per px of local relief, used where no second pair is compared."""
_PRIOR_PIXELS = 5.0
"""Weight of that error, as a number of compared pixels."""
_LOCAL_FREEDOM = 4.0
"""Weight of the neighbourhood's spread beside the pixel's own, as degrees of freedom."""
_RELIEF_RADIUS_PX = 3.0
"""Gaussian σ of the smoothing from which local relief is measured."""
_MEAN_OF_ROOT = (0.798, 0.886, 0.921, 0.940, 0.952, 0.959, 0.965)
"""E[s]/σ of a standard deviation with 1, 2, … degrees of freedom (c4)."""


def estimate_sigma(fused: FusedDepth, scale_mm_px: float) -> NDArray[np.float32]:
    """Return the (H, W) float32 standard deviation of the mean depth, mm; NaN where there is none.

    The variance between the pairs, of the neighbourhood and of the pixel, is divided by the number of pairs in the
    mean. The variance that all pairs have in common is added, since averaging does not reduce it.

    Parameters
    ----------
    fused
        The mean over the pairs.
    scale_mm_px
        Focal length times baseline (mean over the pairs), px·mm: a disparity error e makes e·Z²/scale of depth.
    """
    measured = fused.views > 0
    mm_per_px = np.where(measured, fused.depth_mm, 1.0) ** 2 / np.float32(scale_mm_px)
    scatter = np.where(measured, fused.scatter_mm2 / mm_per_px**2, 0).astype(np.float32)
    freedom = np.maximum(fused.views.astype(np.float32) - 1.0, 0.0)
    relief2 = _measure_relief(fused.depth_mm, cast("NDArray[np.float32]", mm_per_px)) ** 2
    guess = np.sqrt(_FLOOR_PX**2 + _ROUGHNESS**2 * relief2).astype(np.float32)
    local = _pool_spread(scatter, fused.views, guess)
    single = (_LOCAL_FREEDOM * local**2 + scatter) / (_LOCAL_FREEDOM + freedom)
    beyond = np.maximum(single - _FLOOR_PX**2, 0.0)
    shared = np.minimum(_SHARED * beyond, _SHARED_RELIEF * relief2)
    mean = single * (1.0 + _CORRELATION * freedom) / (1.0 + freedom)
    variance = mean + shared
    return np.where(measured, np.sqrt(variance) * mm_per_px, np.nan).astype(np.float32)


def _pool_spread(
    scatter: NDArray[np.float32], views: NDArray[np.uint8], guess: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the (H, W) standard deviation of one pair, px: the window's mean, or the guess where little is compared.

    Deviations are averaged instead of their squares, so that a few gross ones do not dominate the window.
    """
    root_mean = np.array((1.0, 1.0, *_MEAN_OF_ROOT), np.float32)[np.minimum(views, len(_MEAN_OF_ROOT) + 1)]
    compared = views > 1
    freedom = np.maximum(views.astype(np.float32) - 1.0, 1.0)
    spread = np.where(compared, np.sqrt(scatter / freedom) / root_mean, 0).astype(np.float32)
    total = _sum_windows(spread) + _PRIOR_PIXELS * guess
    return (total / (_sum_windows(compared.astype(np.float32)) + _PRIOR_PIXELS)).astype(np.float32)


def _measure_relief(depth_mm: NDArray[np.float32], mm_per_px: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the (H, W) mean height above the smoothed surroundings, px of disparity."""
    measured = np.isfinite(depth_mm)
    weight = np.maximum(_blur(measured.astype(np.float32)), 1e-3)
    smooth = _blur(np.where(measured, depth_mm, 0)) / weight
    height = np.where(measured, np.minimum(np.abs(depth_mm - smooth) / mm_per_px, 1.0), 0)
    return (_blur(height.astype(np.float32)) / weight).astype(np.float32)


def _blur(values: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), _RELIEF_RADIUS_PX), np.float32)


def _sum_windows(values: NDArray[np.float32]) -> NDArray[np.float32]:
    total = cv2.boxFilter(values, -1, (_WINDOW_PX, _WINDOW_PX), normalize=False)
    return np.maximum(np.asarray(total, np.float32), 0)  # running sums may be negative by a rounding error


class PairwiseReconstructor:
    """The pairwise matcher for one rig and depth range; it reconstructs any number of frames."""

    def __init__(
        self,
        rig: Rig,
        depth_range_mm: tuple[float, float],
        settings: PairwiseSettings,
        *,
        auxiliaries: tuple[str, ...] | None = None,
    ) -> None:
        """Prepare ``auxiliaries`` (all of the rig by default) for surfaces within (near, far) in mm.

        Raises
        ------
        ReconstructionError
            When there is no auxiliary, one is not in the rig, or a pair cannot be rectified.
        """
        require_depth_range(depth_range_mm)
        names = check_auxiliaries(rig, auxiliaries)
        settings = settings.revalidate()
        self.rig = rig
        self.depth_range_mm = depth_range_mm
        self.settings = settings
        with ThreadPoolExecutor(settings.threads or count_usable_cores()) as pool:
            make_matcher = partial(make_pair_matcher, rig, depth_range_mm=depth_range_mm, settings=settings)
            matchers = pool.map(make_matcher, names)
            self._matchers: Mapping[str, PairMatcher] = dict(zip(names, matchers, strict=True))

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        """Return the depth map of one frame; auxiliaries without an image are left out.

        Raises
        ------
        ReconstructionError
            When the core's image or every auxiliary's is missing.
        """
        core = self.rig.core
        names = list_usable_auxiliaries(self.rig, frame_set, tuple(self._matchers))
        core_root = take_square_root(frame_set.images[core])

        def match(name: str) -> NDArray[np.float32]:
            return self._matchers[name].compute_depth(core_root, take_square_root(frame_set.images[name]))

        depths: list[NDArray[np.float32]] = []
        with ThreadPoolExecutor(self.settings.threads or count_usable_cores()) as pool:
            for depth in pool.map(match, names):
                depths.append(depth)
                reporter.step(f"matching {frame_set.frame}", len(depths), len(names))
        pairs = [self._matchers[name].pair for name in names]
        scale = float(np.mean([pair.focal_px * pair.baseline_mm for pair in pairs]))
        agreement = self.settings.agreement_px
        fused = fuse_depths(np.stack(depths), None if agreement is None else agreement / scale)
        confidence = fused.views / np.float32(len(names))  # the share of pairs that agree
        return DepthMap(
            fused.depth_mm, estimate_sigma(fused, scale), fused.views, cast("NDArray[np.float32]", confidence)
        )


def reconstruct_pairwise(
    rig: Rig,
    frame_set: FrameSet,
    settings: PairwiseSettings,
    reporter: Reporter,
    *,
    auxiliaries: tuple[str, ...] | None = None,
    depth_range_mm: tuple[float, float] | None = None,
) -> DepthMap:
    """Return the depth map of one frame by the paper's method; for many frames use `PairwiseReconstructor`.

    Parameters
    ----------
    rig
        The calibrated rig.
    frame_set
        Images of one trigger instant; auxiliaries may be missing.
    settings
        Settings of the matcher.
    reporter
        Receives the progress after each pair.
    auxiliaries
        Auxiliaries to use, all by default; a single one is the paper's binocular method.
    depth_range_mm
        (near, far) along the core's optical axis; by default found from the images.

    Raises
    ------
    ReconstructionError
        When the core's image or every auxiliary's is missing, or no pair can be rectified.

    References
    ----------
    Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, section 2.3, Eqs. 21-25.
    """
    names = list_usable_auxiliaries(rig, frame_set, auxiliaries)
    if depth_range_mm is None:
        depth_range_mm = find_depth_range(rig, frame_set, reporter, settings.threads)
    matcher = PairwiseReconstructor(rig, depth_range_mm, settings, auxiliaries=names)
    return matcher.reconstruct(frame_set, reporter)


def find_horizontal_auxiliary(rig: Rig) -> str:
    """Return the auxiliary whose baseline is closest to the core image's u axis: the paper's binocular set-up.

    Raises
    ------
    ReconstructionError
        When the rig has no auxiliary.
    """
    if not rig.auxiliaries:
        raise ReconstructionError(f"the rig has only its core camera {rig.core}; depth needs a second one")
    return max(rig.auxiliaries, key=lambda name: _cosine_with_u(rig, name))


def _cosine_with_u(rig: Rig, name: str) -> float:
    """Return |cos| of the angle between an auxiliary's baseline and the core image's u axis."""
    baseline = rig.cam_from_core[name].center_mm
    return float(abs(baseline[0]) / np.linalg.norm(baseline))
