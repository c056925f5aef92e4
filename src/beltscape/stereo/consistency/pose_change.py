"""Movements of cameras that explain the residuals of a frame: of one camera, and of sets compared by χ².

The pose change of one camera is fitted with its covariance.

Every set of cameras that leaves a majority at rest is a hypothesis. Its movement is fitted to the medians of the
residuals in blocks of the image; where none explains them, a displacement of each block of its images, as by another
lens or instant, or before and after a movement. A camera is accused only if all hypotheses within `DECISIVE_SIGMAS`
of the best one contain it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from beltscape.core.arrays import Array
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.statistics import MAD_TO_SIGMA, MEDIAN_TO_MEAN_SIGMA
from beltscape.stereo.consistency.residuals import (
    BLOCKS,
    LEAST_IN_BLOCK,
    PairResiduals,
    ResidualReference,
    compute_disparity_residuals,
    compute_pair_residuals,
    find_blocks,
)
from beltscape.stereo.consistency.tie_points import TiePoints

_LOSS_PX = 0.5
"""Scale of Cauchy's loss; larger residuals are false matches and weigh less."""
_BOUND = np.array([0.2, 0.2, 0.2, 100.0, 100.0, 100.0])
"""rad and mm; beyond these the search would not have found the points."""
_KNOCK = 2.0, 20.0
"""A knock turns a camera by less (°) and shifts it by less (mm); a larger pose change that explains a frame arises by
chance among images of other cameras."""
_BIAS_PX = 0.01
"""Systematic error of the matching in one block; rendered captures under their true rigs have 0.005 px."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseChange:
    """Movement of one camera, in its own frame."""

    camera: str
    angle_deg: float
    shift_mm: float
    rig: Rig
    """The rig after the movement."""
    change: Array
    """(6,) rotation vector, rad, and shift of the camera frame, mm."""
    covariance: Array
    """(6, 6) of the change."""

    @property
    def is_plausible(self) -> bool:
        """Return whether a knock may have moved the camera by this."""
        return self.angle_deg < _KNOCK[0] and self.shift_mm < _KNOCK[1]

    @property
    def angle_sigma_deg(self) -> float:
        """Return one standard deviation of the angle."""
        return float(np.rad2deg(_compute_length_sigma(self.change[:3], self.covariance[:3, :3])))

    @property
    def shift_sigma_mm(self) -> float:
        """Return one standard deviation of the shift's length."""
        return _compute_length_sigma(self.change[3:], self.covariance[3:, 3:])


def fit_pose_change(
    tie_points: TiePoints,
    rig: Rig,
    camera: str,
    auxiliaries: Sequence[str],
    reference: ResidualReference | None = None,
) -> PoseChange:
    """Fit the rotation and shift of a camera to the residuals of these auxiliaries, less those of the reference."""
    from scipy.optimize import least_squares  # takes longer to import than a sound frame's whole check

    def compute_residuals(change: Array) -> Array:
        return _stack_residuals(tie_points, apply_pose_change(rig, camera, change), auxiliaries, reference)

    found = np.isfinite(compute_residuals(np.zeros(6)))
    scale = np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0])
    start = np.zeros(6)
    for loss in (10 * _LOSS_PX, _LOSS_PX):  # wide first, so that a large movement is no outlier
        fitted = least_squares(
            lambda change: np.nan_to_num(compute_residuals(change), nan=0.0),
            start,
            loss="cauchy",
            f_scale=loss,
            x_scale=scale,
            bounds=(-_BOUND, _BOUND),
            max_nfev=30,
        )
        start = fitted.x
    change = np.asarray(fitted.x, np.float64)
    scatter = (
        MAD_TO_SIGMA * float(np.median(np.abs(compute_residuals(change)[found]))) if found.any() else 1.0
    )
    # residuals of disparity are twice as many as the auxiliaries leave free; a block's bias is common to its points
    per_block = len(tie_points.core_px) / (BLOCKS[0] * BLOCKS[1])
    variance = 2 * scatter**2 + per_block * (_BIAS_PX * tie_points.pixel_scale) ** 2
    normal = np.asarray(fitted.jac.T @ fitted.jac, np.float64)
    inverse = np.linalg.pinv(normal * np.outer(scale, scale)) * np.outer(scale, scale)
    covariance = np.asarray(variance * inverse, np.float64)
    return PoseChange(
        camera,
        float(np.rad2deg(np.linalg.norm(change[:3]))),
        float(np.linalg.norm(change[3:])),
        apply_pose_change(rig, camera, change),
        change,
        covariance,
    )


def apply_pose_change(rig: Rig, camera: str, change: Array) -> Rig:
    """Return the rig with a camera turned by (3,) rad about its centre and shifted by (3,) mm, in its frame."""
    movement = Pose.of(np.asarray(change[:3], np.float64), change[3:])
    if camera != rig.core:
        return replace(rig, cam_from_core={**rig.cam_from_core, camera: movement @ rig.cam_from_core[camera]})
    inverse = movement.inverse()
    poses = {name: pose if name == camera else pose @ inverse for name, pose in rig.cam_from_core.items()}
    return replace(rig, cam_from_core=poses)


def _compute_length_sigma(vector: Array, covariance: Array) -> float:
    """Return one standard deviation of a vector's length."""
    length = float(np.linalg.norm(vector))
    if not length:
        return float(np.sqrt(np.trace(covariance)))
    unit = vector / length
    return float(np.sqrt(unit @ covariance @ unit))


def _stack_residuals(
    tie_points: TiePoints, rig: Rig, auxiliaries: Sequence[str], reference: ResidualReference | None
) -> Array:
    """Return all epipolar residuals, and the disparity residuals of all pairs of auxiliaries, px; NaN: not found."""
    pixels = tie_points.core_px
    residuals = {name: compute_pair_residuals(tie_points, rig, name) for name in auxiliaries}
    stacked: list[Array] = []
    for name, each in residuals.items():
        epipolar = each.epipolar_px
        stacked.append(epipolar if reference is None else reference.subtract_epipolar(epipolar, pixels, name))
    for one, other in combinations(auxiliaries, 2):
        disparity = compute_disparity_residuals(residuals[one], residuals[other])
        if reference is not None:
            disparity = reference.subtract_disparity(disparity, pixels, (one, other))
        stacked.append(disparity)
    return np.concatenate(stacked)


DECISIVE_SIGMAS = 3.0
"""A hypothesis is refuted from this number of standard deviations on: χ² larger than the best one's by its square."""
_SETS_BIAS_PX = 0.02
"""Systematic error of the matching in one block; rendered captures under their true rigs have 0.005 px, and what lens
models leave varies more."""
_STEPS = np.array([1e-5, 1e-5, 1e-5, 1e-2, 1e-2, 1e-2])
"""Steps of the numerical derivatives, rad and mm: some 0.01 px."""
_PRIOR = np.array([0.1, 0.1, 0.1, 50.0, 50.0, 50.0])
"""Standard deviations of a movement before it is measured, rad and mm: they bound what the residuals leave free."""
_LEAST_MEDIANS = 18
"""Least number of medians for each camera that may have moved, three for each degree of freedom: with fewer a
movement of one camera was explained by those of two others in one of 30 frames of 40 points."""
_LINEAR_PX = 1.0
"""Movements that displace points by less are linear: an angle of 1 px at 600 px of focal length errs by 0.002 px."""
_ITERATIONS = 4
"""Steps of the fit of a larger movement; 2° need three."""


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """Movement of a set of cameras."""

    cameras: tuple[str, ...]
    chi_square: float
    """What is left of the residuals, over their variances."""
    free: float
    """Number of medians less that of fitted parameters."""
    left_px: Array
    """(series,) RMS of what is left of each series: epipolar by auxiliary, disparity by pair; NaN: not measured."""
    margin: float
    """Excess of another's χ² over this one that refutes it."""
    rig: Rig
    """The rig after the movement; the same after a displacement of images."""


@dataclass(frozen=True, slots=True, eq=False)
class _BlockMedians:
    """Medians of all series of residuals in blocks of the image."""

    value_px: Array
    """(B,) medians, NaN where a block has too few points."""
    variance_px2: Array
    """(B,) their variances."""


def list_hypotheses(cameras: Sequence[str], size: int) -> list[tuple[str, ...]]:
    """Return all sets of ``size`` cameras that leave a majority at rest, and at least two."""
    return list(combinations(cameras, size)) if len(cameras) - size >= max(2, size + 1) else []


def find_common(hypotheses: Sequence[Hypothesis]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the cameras that all plausible hypotheses have in common, and those that at least one of them has."""
    best = min(hypotheses, key=lambda each: each.chi_square)
    plausible = [each.cameras for each in hypotheses if each.chi_square < best.chi_square + best.margin]
    order = list(dict.fromkeys(name for each in hypotheses for name in each.cameras))
    common = tuple(name for name in order if all(name in each for each in plausible))
    return common, tuple(name for name in order if any(name in each for each in plausible))


def _rank(hypotheses: list[Hypothesis]) -> list[Hypothesis]:
    """Return the hypotheses, the best one first, with χ² in units of what the best one leaves.

    What it does not explain, such as an error of lens models, is common to the blocks of an image: the excess of its
    χ² over the expectation reduces the weight of all of them by the number of blocks.
    """
    ranked = sorted(hypotheses, key=lambda each: each.chi_square)
    excess = max(ranked[0].chi_square / max(ranked[0].free, 1.0) - 1, 0.0)
    scale = 1 + BLOCKS[0] * BLOCKS[1] * excess
    return [replace(each, chi_square=each.chi_square / scale) for each in ranked]


class MovementFit:
    """Fits movements of cameras to the residuals of tie points under a rig, less those of the reference."""

    def __init__(
        self, tie_points: TiePoints, rig: Rig, names: tuple[str, ...], reference: ResidualReference | None
    ) -> None:
        """``names`` are the auxiliaries whose residuals are used."""
        self._tie_points, self._rig, self._names, self._reference = tie_points, rig, names, reference
        self._blocks = find_blocks(tie_points.core_px, rig.core_camera.size_px)
        pairs = {name: compute_pair_residuals(tie_points, rig, name) for name in names}
        self._base = self._compute_medians(pairs)
        self._used = np.isfinite(self._base.value_px)
        self._slopes = {camera: self._compute_slopes(camera, pairs) for camera in (rig.core, *names)}

    def has_enough(self, size: int) -> bool:
        """Return whether the residuals suffice to compare movements of ``size`` cameras."""
        return int(self._used.sum()) >= _LEAST_MEDIANS * size

    def compare_movements(self, size: int) -> list[Hypothesis]:
        """Return the hypotheses that ``size`` cameras moved, the best one first."""
        sets = list_hypotheses((self._rig.core, *self._names), size)
        return _rank([self._fit_movement(cameras) for cameras in sets])

    def compare_displacements(self, size: int) -> list[Hypothesis]:
        """Return the hypotheses that blocks of ``size`` cameras' images are displaced, the best one first."""
        sets = list_hypotheses((self._rig.core, *self._names), size)
        return _rank([self._fit_displacement(cameras) for cameras in sets])

    def _fit_displacement(self, cameras: tuple[str, ...]) -> Hypothesis:
        """Return the displacements of all blocks of some cameras' images that leave the least χ²."""
        count = BLOCKS[0] * BLOCKS[1]
        block = np.arange(len(self._base.value_px)) % count
        is_own = block[:, None] == np.arange(count)
        columns = [
            is_own * self._slopes[camera][:, axis : axis + 1] for camera in cameras for axis in (0, 1)
        ]  # small turns shift the image
        slopes = np.concatenate(columns, axis=1)[self._used]
        value, weight = self._base.value_px[self._used], 1 / self._base.variance_px2[self._used]
        information = (slopes * weight[:, None]).T @ slopes
        normal = information + np.eye(len(information)) / _PRIOR[0] ** 2
        step = np.asarray(np.linalg.solve(normal, slopes.T @ (weight * value)), np.float64)
        left = value - slopes @ step
        fitted = float(np.trace(np.asarray(np.linalg.solve(normal, information), np.float64)))
        # two hypotheses with this number of parameters explain different parts of the noise by chance
        margin = DECISIVE_SIGMAS**2 + DECISIVE_SIGMAS * float(np.sqrt(4 * fitted))
        return self._make_hypothesis(cameras, left, fitted, margin, self._rig)

    def _make_hypothesis(
        self, cameras: tuple[str, ...], left_px: Array, fitted: float, margin: float, rig: Rig
    ) -> Hypothesis:
        """Return the hypothesis that leaves ``left_px`` of the used medians after ``fitted`` parameters."""
        whole = np.full(len(self._used), np.nan)
        whole[self._used] = np.square(left_px)
        by_series = whole.reshape(-1, BLOCKS[0] * BLOCKS[1])
        number = np.isfinite(by_series).sum(axis=1)
        rms = np.sqrt(np.nansum(by_series, axis=1) / np.where(number > 0, number, np.nan))
        chi_square = float(np.nansum(whole[self._used] / self._base.variance_px2[self._used]))
        return Hypothesis(cameras, chi_square, len(left_px) - fitted, rms, margin, rig)

    def _fit_movement(self, cameras: tuple[str, ...]) -> Hypothesis:
        """Return the movement of a set of cameras that leaves the least χ²."""
        slopes = np.concatenate([self._slopes[camera] for camera in cameras], axis=1)[self._used]
        prior = np.tile(_PRIOR, len(cameras))
        value, variance = self._base.value_px[self._used], self._base.variance_px2[self._used]
        weight = 1 / variance
        normal = (slopes * weight[:, None]).T @ slopes + np.diag(prior**-2)
        change = np.zeros(len(prior))
        for _ in range(_ITERATIONS):
            step = -np.linalg.solve(normal, slopes.T @ (weight * value) + change / prior**2)
            change, moved = change + step, slopes @ step
            value = value + moved
            if float(np.abs(moved).max(initial=0.0)) < _LINEAR_PX:
                break
            value = np.nan_to_num(self._measure(self._move(cameras, change))[self._used])
        margin = DECISIVE_SIGMAS**2
        return self._make_hypothesis(cameras, value, len(change), margin, self._move(cameras, change))

    def _move(self, cameras: tuple[str, ...], change: Array) -> Rig:
        """Return the rig after movements (6·n,) of n cameras; the core's last, since it moves all others."""
        rig = self._rig
        for i in sorted(range(len(cameras)), key=lambda i: cameras[i] == rig.core):
            rig = apply_pose_change(rig, cameras[i], change[6 * i : 6 * i + 6])
        return rig

    def _measure(self, rig: Rig) -> Array:
        """Return (B,) medians of the residuals under a rig."""
        pairs = {name: compute_pair_residuals(self._tie_points, rig, name) for name in self._names}
        return self._compute_medians(pairs).value_px

    def _compute_slopes(self, camera: str, pairs: Mapping[str, PairResiduals]) -> Array:
        """Return (B, 6) derivatives of the block medians by the movement of a camera, as means over the blocks."""
        before = self._stack(pairs)
        slopes = np.empty((len(self._base.value_px), 6))
        affected = self._names if camera == self._rig.core else (camera,)
        for i in range(6):
            change = np.zeros(6)
            change[i] = _STEPS[i]
            rig = apply_pose_change(self._rig, camera, change)
            moved = {name: compute_pair_residuals(self._tie_points, rig, name) for name in affected}
            after = self._stack({**pairs, **moved})
            slopes[:, i] = np.concatenate([
                self._average((new - old) / _STEPS[i]) for new, old in zip(after, before, strict=True)
            ])  # fmt: skip
        return slopes

    def _stack(self, pairs: Mapping[str, PairResiduals]) -> list[Array]:
        """Return all series (N,) of residuals, px: epipolar ones by auxiliary, then disparities by pair."""
        disparities = (
            compute_disparity_residuals(pairs[one], pairs[other])
            for one, other in combinations(self._names, 2)
        )
        return [*(pairs[name].epipolar_px for name in self._names), *disparities]

    def _subtract(self, series: list[Array]) -> list[Array]:
        """Return the series without the reference."""
        reference, pixels = self._reference, self._tie_points.core_px
        if reference is None:
            return series
        count = len(self._names)
        return [
            *(
                reference.subtract_epipolar(px, pixels, name)
                for px, name in zip(series, self._names, strict=False)
            ),
            *(
                reference.subtract_disparity(px, pixels, pair)
                for px, pair in zip(series[count:], combinations(self._names, 2), strict=True)
            ),
        ]

    def _compute_medians(self, pairs: Mapping[str, PairResiduals]) -> _BlockMedians:
        count = len(self._names)
        # disparities of all pairs hold the same information several times
        repeated = [1.0] * count + [max(1.0, count / 2)] * (count * (count - 1) // 2)
        found = [self._find_medians(px) for px in self._subtract(self._stack(pairs))]
        medians, numbers, scatters = (np.array(values) for values in zip(*found, strict=True))
        # few points scatter less than their noise by chance, but seldom in most series
        scatters = np.maximum(scatters, np.nanmedian(scatters) if np.isfinite(scatters).any() else 0.0)
        with np.errstate(divide="ignore"):
            variances = MEDIAN_TO_MEAN_SIGMA**2 * scatters[:, None] ** 2 / numbers + _SETS_BIAS_PX**2
        return _BlockMedians(medians.ravel(), (np.array(repeated)[:, None] * variances).ravel())

    def _find_medians(self, residual_px: Array) -> tuple[Array, Array, float]:
        """Return medians (blocks,) of a series, their numbers of points, and one standard deviation of a point."""
        medians, numbers = np.full(BLOCKS[0] * BLOCKS[1], np.nan), np.zeros(BLOCKS[0] * BLOCKS[1])
        good = np.isfinite(residual_px)
        deviations: list[Array] = []
        for block in np.unique(self._blocks[good]):
            own = residual_px[good & (self._blocks == block)]
            if len(own) >= LEAST_IN_BLOCK:
                medians[block], numbers[block] = np.median(own), len(own)
                deviations.append(np.abs(own - medians[block]))
        if not deviations:
            return medians, numbers, float("nan")
        every = np.concatenate(deviations)
        free = len(every) / (len(every) - len(deviations))
        return medians, numbers, MAD_TO_SIGMA * float(np.median(every)) * float(np.sqrt(free))

    def _average(self, values: Array) -> Array:
        """Return (blocks,) means of the finite values; 0 where there are none."""
        good = np.isfinite(values)
        size = BLOCKS[0] * BLOCKS[1]
        sums = np.bincount(self._blocks[good], values[good], size)
        return sums / np.maximum(np.bincount(self._blocks[good], minlength=size), 1)
