"""Result of the camera consistency check: the state of each auxiliary, and what explains the contradictions.

The row error of an auxiliary is a function of place, a robust fit of its epipolar residuals over the core's image.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array
from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.stereo.consistency.pose_change import PoseChange
from beltscape.stereo.consistency.residuals import LEAST_POINTS
from beltscape.stereo.consistency.tie_points import TiePoints

TERMS = 4
"""Offset, slope in x, slope in y, and change with the inverse depth."""
_NEAR_PX = 1.0
"""A point agrees with the fitted function within this distance, px of the matched images."""
_SAMPLES = 200
"""Number of random samples of `TERMS` points; where 43 % of the matches are right, 99.9 % of the draws hold a sample
without a false one."""
_REFITS = 4
"""Fits to the points near the function before; the points that agree no longer change then."""
_USED_SIGMAS = 3.0
"""Points beyond this number of standard deviations agree, but are not fitted: chance matches among the right ones."""
_PRIOR_PX = 40.0
"""Standard deviation of each term before it is measured; bounds what a plane surface leaves open."""


@dataclass(frozen=True, slots=True)
class RowFit:
    """The function that most points of an image agree with, along the normals of their epipolar lines; NaN: none."""

    offset_px: float
    """In the middle of the image, at the mean depth."""
    slope_x_px: float
    """Change from the middle of the core's image to its right edge."""
    slope_y_px: float
    """Change from the middle of the core's image to its lower edge."""
    depth_px: float
    """Change by one standard deviation of the points' inverse depths, where these are not a plane's."""
    rms_px: float
    """RMS of the function over the points that agree with it."""
    sigma_px: float
    """One standard deviation of the offset."""
    explained: int
    """Number of points that agree with the function."""

    @property
    def extent_px(self) -> tuple[float, float]:
        """Return the least and greatest row error over the image, at the mean depth; NaN: not measured."""
        slope = abs(self.slope_x_px) + abs(self.slope_y_px)
        return self.offset_px - slope, self.offset_px + slope


_NAN = float("nan")
NO_FIT = RowFit(_NAN, _NAN, _NAN, _NAN, _NAN, _NAN, 0)
"""The fit where there are too few points."""


def fit_rows(
    epipolar_px: Array,
    pixels: Array,
    inverse_depth: Array,
    size_px: tuple[int, int],
    pixel_scale: float = 1.0,
) -> RowFit:
    """Fit the row error to epipolar residuals (N,), NaN where missing, at pixels (N, 2) of the core's image.

    The function is the one with which most points agree, so that false matches do not count. ``inverse_depth`` is
    (N,), and ``pixel_scale`` the pixel of the images in which the points were matched, in px of the rig's images.
    """
    good = np.isfinite(epipolar_px) & np.isfinite(inverse_depth)
    values, near = epipolar_px[good], _NEAR_PX * pixel_scale
    if len(values) < LEAST_POINTS:
        return NO_FIT
    design = _make_design(pixels[good], inverse_depth[good], size_px)
    agrees = _find_consensus(design, values, near)
    terms, used, scatter = np.zeros(TERMS), agrees, near
    for _ in range(_REFITS):
        normal = design[used].T @ design[used] + np.eye(TERMS) * (near / _PRIOR_PX) ** 2
        terms = np.asarray(np.linalg.solve(normal, design[used].T @ values[used]), np.float64)
        left = np.abs(values - design @ terms)
        agrees = left < near
        if agrees.sum() < LEAST_POINTS:
            return NO_FIT
        scatter = MAD_TO_SIGMA * float(np.median(left[agrees]))
        used = left <= min(near, _USED_SIGMAS * scatter)
    rms = float(np.sqrt(np.mean(np.square(design[agrees] @ terms))))
    sigma = scatter / float(np.sqrt(agrees.sum()))
    offset, slope_x, slope_y, depth = (float(term) for term in terms)
    return RowFit(offset, slope_x, slope_y, depth, rms, sigma, int(agrees.sum()))


def _make_design(pixels: Array, inverse_depth: Array, size_px: tuple[int, int]) -> Array:
    """Return (N, 4) of 1, x and y from -1 to 1 over the image, and what these leave of the scaled inverse depth.

    On a plane they leave nothing of it, and the slopes hold all.
    """
    place = np.column_stack([np.ones(len(pixels)), 2 * (pixels + 0.5) / size_px - 1])
    middle = float(np.median(inverse_depth))
    spread = MAD_TO_SIGMA * float(np.median(np.abs(inverse_depth - middle)))
    depth = np.clip((inverse_depth - middle) / max(spread, 1e-12), -3, 3)
    left = depth - place @ np.linalg.lstsq(place, depth)[0]
    return np.column_stack([place, left])


def _find_consensus(design: Array, values: Array, near_px: float) -> NDArray[np.bool_]:
    """Return (N,) the points that agree with the function through random points that most agree with.

    The rig as it is, and a mere offset, are among the functions that are tried first.
    """
    rng = np.random.default_rng(0)
    # the first of a sorted row, without sorting the rest
    drawn = np.argpartition(rng.random((_SAMPLES, len(values))), range(TERMS), axis=1)[:, :TERMS]
    samples, prior = design[drawn], np.eye(TERMS) * (near_px / _PRIOR_PX) ** 2
    normal = np.einsum("sni,snj->sij", samples, samples) + prior
    right = np.einsum("sni,sn->si", samples, values[drawn])
    terms = np.asarray(np.linalg.solve(normal, right[..., None]), np.float64)[..., 0]
    offset = np.array([[float(np.median(values)), 0.0, 0.0, 0.0]])
    trials = np.concatenate([np.zeros((1, TERMS)), offset, terms])
    left = trials @ design.T
    left -= values
    agrees = np.abs(left, out=left) < near_px
    return np.asarray(agrees[int(np.count_nonzero(agrees, axis=1).argmax())], np.bool_)


State = Literal["sound", "contradicting", "unmatched", "undecided", "not measured"]
"""State of an auxiliary:

sound           its points agree with the rig within the tolerance
contradicting   their systematic residuals exceed the tolerance
unmatched       it shows hardly any of the core's points
undecided       those that agree are outnumbered by those that have no match or another one
not measured    too few points were searched or found
"""


@dataclass(frozen=True, slots=True)
class CameraConsistency:
    """Consistency of one auxiliary camera with the rig."""

    camera: str
    state: State
    epipolar_px: float
    """Systematic epipolar residual, RMS over the image; NaN: not measured."""
    epipolar_sigma_px: float
    """One standard deviation of it."""
    disparity_px: float
    """Systematic disparity residual against the other auxiliaries, their median; NaN: not measured."""
    tolerance_px: float
    """Tolerance of the epipolar residual, from the rig's covariance and the matching."""
    points: int
    """Number of points found."""
    searched: int
    """Number of textured points that lie in its image."""
    agreement: float
    """Share of the searched points found within a pixel of their epipolar line; NaN: none searched."""
    depth_mm_per_px: float
    """Error of the depth that one pixel of error along the epipolar lines causes, mm; NaN without tie points."""
    rows: RowFit
    """The row error as a function of place."""
    failing: int = 0
    """Number of textured points in its view without a depth, or found off their epipolar lines."""

    @property
    def depth_error_mm(self) -> float:
        """Return the size of the residuals as an error of depth; NaN where they were not measured.

        The difference of two auxiliaries' disparities is normalised to one pixel of error in either image; a camera
        that is off by itself is off by √2 of it.
        """
        along = float(np.nan_to_num(self.disparity_px)) * float(np.sqrt(2))
        return float(np.hypot(self.epipolar_px, along)) * self.depth_mm_per_px


@dataclass(frozen=True, slots=True, eq=False)
class RigConsistency:
    """Consistency of a rig with the images of one frame, or of several."""

    cameras: tuple[CameraConsistency, ...]
    textured_points: int
    """Number of textured points of the core image."""
    guided: bool
    """Whether a depth map guided the matching."""
    ambiguous: bool
    """Whether the frame does not show which of the contradicting cameras is right."""
    core_moved: bool
    """Whether the core moved: every plausible explanation of the contradictions contains it."""
    pose_change: PoseChange | None
    """The pose change of one camera that explains the contradictions; None if there is none."""
    found_depth_range_mm: tuple[float, float]
    """Near and far end of the depths at which unguided matching found the points; NaN if too few."""
    misfit_px: float
    """Greatest excess of a systematic residual of the sound auxiliaries, or of all if none is sound."""
    tie_points: TiePoints
    """The matched points."""
    is_change: bool = False
    """Whether the residuals are those since a reference was taken."""
    suspects: tuple[str, ...] = ()
    """Cameras of which one moved, while the images do not show yet which; also the core."""
    is_searched: bool = False
    """Whether the points were also searched without the depth map."""

    @property
    def is_confirmed(self) -> bool:
        """Return whether every auxiliary is sound, by the depth map and by the search without it."""
        return self.is_searched and self.guided and len(self.find_auxiliaries("sound")) == len(self.cameras)

    def find_auxiliaries(self, *states: State) -> tuple[str, ...]:
        """Return the auxiliaries in one of the states."""
        return tuple(each.camera for each in self.cameras if each.state in states)

    @property
    def inconsistent(self) -> tuple[str, ...]:
        """Auxiliaries that contradict the rig or are unmatched."""
        return self.find_auxiliaries("contradicting", "unmatched")

    @property
    def is_sound(self) -> bool:
        """Return whether every auxiliary is consistent or was not measured."""
        return not self.inconsistent


def make_consistency_document(consistency: RigConsistency) -> Mapping[str, object]:
    """Return the consistency as plain values for JSON."""
    change = consistency.pose_change
    return {
        "textured_points": consistency.textured_points,
        "guided_by_depth": consistency.guided,
        "core_moved": consistency.core_moved,
        "ambiguous": consistency.ambiguous,
        "suspects": list(consistency.suspects),
        "misfit_px": consistency.misfit_px,
        "motion": change
        and {
            "camera": change.camera,
            "angle_deg": change.angle_deg,
            "angle_sigma_deg": change.angle_sigma_deg,
            "shift_mm": change.shift_mm,
            "shift_sigma_mm": change.shift_sigma_mm,
        },
        "cameras": [
            {
                "camera": each.camera,
                "state": each.state,
                "epipolar_px": each.epipolar_px,
                "epipolar_sigma_px": each.epipolar_sigma_px,
                "along_px": each.disparity_px,
                "allowed_px": each.tolerance_px,
                "points": each.points,
                "searched": each.searched,
                "agreement": each.agreement,
                "failing": each.failing,
                "row_error": {
                    "offset_px": each.rows.offset_px,
                    "slope_x_px": each.rows.slope_x_px,
                    "slope_y_px": each.rows.slope_y_px,
                    "depth_px": each.rows.depth_px,
                    "rms_px": each.rows.rms_px,
                    "sigma_px": each.rows.sigma_px,
                    "points": each.rows.explained,
                },
                "depth_error_mm": each.depth_error_mm,
            }
            for each in consistency.cameras
        ],
    }
