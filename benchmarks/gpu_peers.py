"""Other matchers beside ours, on the same pairs: OpenCV's SGBM on the processor, and its CUDA SGM where there is one.

A set is a pair of every auxiliary with the core, rectified beforehand. What a matcher does is counted in disparity
evaluations: pixels × pairs × disparities. Ours sweeps no full range; its count is what a full sweep would take.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.pairwise.rectification import equalise_contrast, rectify_images, take_square_root
from beltscape.stereo.pairwise.sgbm import PairMatcher, correct_bias, make_pair_matcher, sample_values
from beltscape.stereo.settings import PairwiseSettings

CUDA_DISPARITIES = (64, 128, 256)
"""Ranges that the CUDA SGM has."""
_RUNS = 3
_BLOCK_PX = 3
_SMALL, _LARGE = 8 * _BLOCK_PX**2, 32 * _BLOCK_PX**2
"""SGBM's penalties by OpenCV's documentation."""

Depth = NDArray[np.floating]


@dataclass(frozen=True)
class MatcherRow:
    """How fast and how exact one matcher is on a set."""

    name: str
    size_px: tuple[int, int]
    """Width and height of the core's image."""
    pairs: int
    disparities: int
    """Range of the search, px of the core's image."""
    seconds: float
    """For a set; of several in flight the time from one result to the next."""
    error_mm: float | None
    """Median of the absolute error of depth; None without a truth."""
    measured_share: float

    @property
    def evaluations_per_s(self) -> float:
        """Disparity evaluations a second."""
        width, height = self.size_px
        return width * height * self.pairs * self.disparities / self.seconds


@dataclass(frozen=True)
class Pair:
    """A rectified pair, and how its disparity becomes depth on the core's grid."""

    matcher: PairMatcher
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]

    def convert(self, sixteenths: NDArray[np.int16]) -> Depth:
        """Return the depth (h, w), mm, of OpenCV's disparity in 1/16 px; NaN where there is none."""
        disparity = sample_values(correct_bias(sixteenths), self.matcher.sample_map)
        return self.matcher.pair.depth_from_disparity(disparity) / self.matcher.depth_ratio


def rectify_pairs(rig: Rig, frame_set: FrameSet, near_far_mm: tuple[float, float]) -> list[Pair]:
    """Return the pairs of all auxiliaries, with equal contrast as SGM needs it."""
    settings = PairwiseSettings()
    pairs: list[Pair] = []
    for name in rig.auxiliaries:
        matcher = make_pair_matcher(rig, name, near_far_mm, settings)
        both = rectify_images(frame_set, matcher.pair)
        left, right = (
            equalise_contrast(take_square_root(image), settings.contrast_radius_px)
            for image in (both.core, both.auxiliary)
        )
        pairs.append(Pair(matcher, left, right))
    return pairs


def compute_error(depth_mm: Depth, true_mm: Depth | None) -> float | None:
    """Return the median of the absolute error, mm; None without a truth or a common pixel."""
    if true_mm is None:
        return None
    off = np.abs(depth_mm - true_mm)
    return float(np.nanmedian(off)) if np.isfinite(off).any() else None


def measure_others(
    pairs: Sequence[Pair], size_px: tuple[int, int], true_mm: Depth | None
) -> list[MatcherRow]:
    """Return a row for each other matcher that this machine has, see `explain_missing`."""
    rows = [_measure_sgbm(pairs, size_px, true_mm)]
    return rows if explain_missing(pairs) else [*rows, _measure_cuda(pairs, size_px, true_mm)]


def explain_missing(pairs: Sequence[Pair]) -> str:
    """Return why the CUDA SGM is not among the other matchers; an empty text where it is."""
    opencv: Any = cv2
    if not hasattr(opencv.cuda, "createStereoSGM"):
        return f"OpenCV {cv2.__version__} was built without CUDA's stereo matching, as all of its wheels are"
    if not opencv.cuda.getCudaEnabledDeviceCount():
        return f"OpenCV {cv2.__version__} finds no GPU"
    needed = _find_range(pairs)
    return "" if needed <= CUDA_DISPARITIES[-1] else f"it has no range of {needed} px"


def _find_range(pairs: Sequence[Pair]) -> int:
    return max(pair.matcher.pair.disparities for pair in pairs)


def _measure_sgbm(pairs: Sequence[Pair], size_px: tuple[int, int], true_mm: Depth | None) -> MatcherRow:
    """Measure OpenCV's SGBM on all cores of the processor."""
    most = _find_range(pairs)
    sgbm = cv2.StereoSGBM.create(
        0, most, _BLOCK_PX, _SMALL, _LARGE, 1, 63, 10, 0, 0, cv2.STEREO_SGBM_MODE_SGBM
    )
    jobs = [lambda pair=pair: np.asarray(sgbm.compute(pair.left, pair.right)) for pair in pairs]
    return _measure("OpenCV SGBM, processor", pairs, jobs, most, size_px, true_mm)


def _measure_cuda(pairs: Sequence[Pair], size_px: tuple[int, int], true_mm: Depth | None) -> MatcherRow:
    """Measure OpenCV's CUDA SGM, which has libSGM's kernels."""
    opencv: Any = cv2
    enough = next(disparities for disparities in CUDA_DISPARITIES if disparities >= _find_range(pairs))
    sgm = opencv.cuda.createStereoSGM(0, enough)

    def match(pair: Pair) -> NDArray[np.int16]:
        left, right = (opencv.cuda_GpuMat(image) for image in (pair.left, pair.right))
        return np.asarray(sgm.compute(left, right).download())

    jobs = [lambda pair=pair: match(pair) for pair in pairs]
    return _measure("OpenCV CUDA SGM (libSGM's kernels), GPU", pairs, jobs, enough, size_px, true_mm)


def _measure(
    name: str,
    pairs: Sequence[Pair],
    jobs: Sequence[Callable[[], NDArray[np.int16]]],
    disparities: int,
    size_px: tuple[int, int],
    true_mm: Depth | None,
) -> MatcherRow:
    times: list[float] = []
    found: list[NDArray[np.int16]] = []
    for _ in range(_RUNS):
        start = time.perf_counter()
        found = [job() for job in jobs]
        times.append(time.perf_counter() - start)
    depths = [pair.convert(sixteenths) for pair, sixteenths in zip(pairs, found, strict=True)]
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # pixels that no pair measures
        depth = np.nanmedian(np.stack(depths), axis=0)
    error, share = compute_error(depth, true_mm), float(np.isfinite(depth).mean())
    return MatcherRow(name, size_px, len(pairs), disparities, min(times), error, share)


def format_rows(rows: Sequence[MatcherRow]) -> list[str]:
    """Return the table of all matchers, the fastest first."""
    lines = [
        "| matcher | resolution | range px | ms a set | sets/s | Gde/s | median error mm | measured |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in sorted(rows, key=lambda row: -row.evaluations_per_s):
        error = "–" if row.error_mm is None else f"{row.error_mm:.3f}"
        width, height = row.size_px
        lines.append(
            f"| {row.name} | {row.pairs + 1} × {width} × {height} | {row.disparities} | "
            f"{row.seconds * 1e3:.1f} | {1 / row.seconds:.1f} | {row.evaluations_per_s / 1e9:.1f} | {error} | "
            f"{row.measured_share:.1%} |"
        )
    return lines
