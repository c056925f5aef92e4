"""Binocular calibration: the pose between every two cameras that share views (the paper's Section 2.2.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.calibrate.corners import Sightings, spread_in_two_directions
from beltscape.calibrate.intrinsics import OUTLIER_FACTOR, Monocular
from beltscape.core.errors import CalibrationError
from beltscape.core.pose import Pose
from beltscape.core.progress import Reporter

MIN_COMMON = 6
"""Corners that two cameras must share in a frame for it to count."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two cameras and the pose between them."""

    first: str
    second: str
    second_from_first: Pose
    rms_px: float
    """Reprojection RMS in both images over the frames used, intrinsics fixed."""
    frames: tuple[str, ...]
    corners: int
    """Corners seen by both, over the frames used."""
    rejected: Mapping[str, str] = field(default_factory=dict)
    """Frame → why it was left out."""

    @property
    def variance(self) -> float:
        """How far the pair can be trusted, px²: the squared RMS over the corners that share it."""
        return self.rms_px**2 / self.corners


def calibrate_pairs(
    sightings: Sightings,
    cameras: Mapping[str, Monocular],
    board_mm: NDArray[np.float64],
    reporter: Reporter,
) -> tuple[Pair, ...]:
    """Every pair of cameras that shares views: n(n-1)/2 of them in a rig where all see the board (Eqs. 7-8)."""
    found: list[Pair] = []
    candidates = list(combinations(cameras, 2))
    for done, (first, second) in enumerate(candidates, start=1):
        pair = calibrate_pair(sightings, cameras[first], cameras[second], board_mm)
        if pair is not None:
            found.append(pair)
        reporter.step("calibrating pairs", done, len(candidates))
    return tuple(found)


def calibrate_pair(
    sightings: Sightings, first: Monocular, second: Monocular, board_mm: NDArray[np.float64]
) -> Pair | None:
    """The pose between two cameras, or None where they share no usable view."""
    names = first.camera.name, second.camera.name
    common = {
        frame: ids
        for frame, ids in sightings.common(*names).items()
        if len(ids) >= MIN_COMMON and spread_in_two_directions(board_mm[ids, :2])
        and frame not in first.rejected and frame not in second.rejected
    }  # fmt: skip
    rejected: dict[str, str] = {}
    while common:
        pose, rms, per_view = _solve(sightings, first, second, board_mm, common)
        median = float(np.median(list(per_view.values())))
        bad = {frame: e for frame, e in per_view.items() if e > max(OUTLIER_FACTOR * median, 0.3)}
        if not bad or len(bad) > len(common) // 3:
            corners = sum(len(ids) for ids in common.values())
            return Pair(*names, pose, rms, tuple(common), corners, rejected)
        for frame, error in bad.items():
            rejected[frame] = f"RMS {error:.2f} px in the pair, the median frame has {median:.2f} px"
            del common[frame]
    return None


def _solve(
    sightings: Sightings,
    first: Monocular,
    second: Monocular,
    board_mm: NDArray[np.float64],
    common: Mapping[str, NDArray[np.int64]],
) -> tuple[Pose, float, dict[str, float]]:
    def pixels(name: str) -> list[NDArray[np.float32]]:
        views = sightings.views[name]
        return [
            views[frame].pixels[np.searchsorted(views[frame].ids, ids)].astype(np.float32)
            for frame, ids in common.items()
        ]

    a, b = first.camera, second.camera
    try:
        result = cv2.stereoCalibrateExtended(
            [board_mm[ids].astype(np.float32) for ids in common.values()],
            pixels(a.name), pixels(b.name), a.matrix, a.distortion, b.matrix, b.distortion, a.size_px,
            np.eye(3), np.zeros(3), flags=cv2.CALIB_FIX_INTRINSIC,
            criteria=(cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-10),
        )  # fmt: skip
    except cv2.error as error:
        raise CalibrationError(
            f"cameras {a.name} and {b.name}: their {len(common)} common views give no pose ({error.err})"
        ) from error
    rms, rotation, translation, per_view = float(result[0]), result[5], result[6], result[-1]
    errors = np.sqrt((np.asarray(per_view) ** 2).mean(axis=1))
    return Pose.of(rotation, translation), rms, {f: float(e) for f, e in zip(common, errors, strict=True)}
