"""Quality of a rig's fit to board views: RMS against median, residuals against the corners' noise.

The noise is estimated from differences between neighbouring corners of one view. A wrong lens, a moved camera or a
bent board displaces neighbouring corners alike; noise does not. Second differences of the residuals along rows and
columns of the board cancel the former and keep the latter.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.assessment.score import RigErrors, Score, ViewResiduals
from beltscape.calibration.solver.bundle import estimate_robust_sigma
from beltscape.core.arrays import Array

MIN_DIFFERENCES = 40
"""Least number of differences for an estimate: its relative standard deviation is then below a fifth."""


def estimate_corner_noise_px(views: Iterable[ViewResiduals], triples: NDArray[np.int64]) -> float:
    """Return one standard deviation of a corner's coordinate, from its neighbours, px; NaN with too few of them.

    ``triples`` (T, 3) are ids of three corners in a row (`beltscape.target.board.list_triples`).
    """
    differences = np.concatenate(
        [np.empty((0, 2)), *(_compute_second_differences(view, triples) for view in views)]
    )
    return (
        estimate_robust_sigma(differences) / np.sqrt(6)
        if differences.size >= MIN_DIFFERENCES
        else float("nan")
    )


def _compute_second_differences(view: ViewResiduals, triples: NDArray[np.int64]) -> Array:
    """Return e₋₁ − 2 e₀ + e₊₁ (n, 2) of three corners in a row or column, px; six times the variance of one."""
    errors = np.full((max(int(triples.max(initial=0)), int(view.ids.max(initial=0))) + 1, 2), np.nan)
    errors[view.ids] = view.errors_px
    before, middle, after = errors[triples].transpose(1, 0, 2)
    differences = before - 2 * middle + after
    return differences[np.isfinite(differences).all(axis=1)]


MAX_TAIL, MIN_TAIL_PX = 2.5, 0.2
"""RMS over median, and RMS, from which on some views fit far worse than the rest.

1.2 is the normal distribution's; the sound sets tried (rendered and recorded) have 1.3 to 2.0, a rig with blurred
views 3.5.
"""
PATTERN, PATTERN_PX = 4.0, 0.1
"""Variance of residuals over that of the corners' noise, and their σ, from which on they are a pattern.

Sound sets have 0.6 to 3, lenses or boards that the model does not follow 10 to 30, cameras that are not synchronous
150 to 700.
"""
MAX_RMS_FACTOR, MIN_RMS_PX = 4.0, 0.1
"""RMS over the corners' noise, and RMS in px, from which on a part of a camera's image or views does not fit: noise
alone makes 1.4. The robust σ does not see a lens that is wrong at the edge of the image only."""
MIN_FAR_SHARE = 0.005
"""Share of a camera's corners that are far off from which on they are a part of it: single corners that a detector
misplaced by some px are left out of the rig and counted."""
FAR = 4.5
"""Corners with larger errors, in robust standard deviations of their camera, are far off."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraFit:
    """Residuals of one camera compared with the noise of its corners."""

    sigma_px: float
    """Robust standard deviation of a residual's coordinate."""
    corner_noise_px: float
    """One standard deviation of a corner's coordinate, from its neighbours; NaN with too few of them."""
    rms_px: float = float("nan")
    """RMS length of the residuals."""
    far_share: float = 1.0
    """Share of the residuals that are far off."""

    @property
    def has_far_residuals(self) -> bool:
        """Whether a part of the corners fits far worse than noise, though the robust σ is no pattern."""
        far = self.rms_px > max(MAX_RMS_FACTOR * self.corner_noise_px, MIN_RMS_PX)
        return bool(far and self.far_share > MIN_FAR_SHARE and not self.is_pattern())

    @property
    def chi2_per_dof(self) -> float:
        """Variance of the residuals over that of the corners' noise, about 1 if noise explains them."""
        return (self.sigma_px / self.corner_noise_px) ** 2 if self.corner_noise_px > 0 else float("nan")

    def is_pattern(self, limit_px: float = PATTERN_PX) -> bool:
        """Return whether the residuals are more than noise, and more than ``limit_px``."""
        return self.sigma_px > limit_px and self.chi2_per_dof > PATTERN


@dataclass(frozen=True, slots=True, eq=False)
class FitQuality:
    """Assessment of a fit by its own residuals."""

    rms_over_median: float
    """Of the reprojection errors; 1.2 for normal noise."""
    far_off_share: float
    """Share of the corners that are far off."""
    cameras: Mapping[str, CameraFit]
    findings: tuple[str, ...]
    """Faults of the fit, each in one line with the likely reason and the fix; empty for a sound fit."""

    @property
    def is_sound(self) -> bool:
        """Return whether the fit has no faults."""
        return not self.findings

    def document(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return {
            "sound": self.is_sound,
            "doubts": self.findings,
            "rms_over_median": self.rms_over_median,
            "far_off_share": self.far_off_share,
            "cameras": {
                name: {
                    "sigma_px": fit.sigma_px,
                    "corner_noise_px": fit.corner_noise_px,
                    "chi2_per_dof": fit.chi2_per_dof,
                    "rms_px": fit.rms_px,
                }
                for name, fit in self.cameras.items()
            },
        }


def estimate_residual_sigma_px(errors_px: Iterable[NDArray[np.float64]]) -> float:
    """Return the robust standard deviation of a coordinate of residuals (n, 2), px."""
    return estimate_robust_sigma(np.concatenate(list(errors_px)))


def compute_camera_fits(rig_errors: RigErrors, triples: NDArray[np.int64]) -> dict[str, CameraFit]:
    """Return each camera's residuals against its corners' noise, for the cameras that have any."""
    return {
        name: _compute_fit(list(views.values()), triples)
        for name, views in rig_errors.residuals.items()
        if views
    }


def _compute_fit(views: Sequence[ViewResiduals], triples: NDArray[np.int64]) -> CameraFit:
    errors = np.concatenate([view.errors_px for view in views])
    lengths, sigma_px = np.linalg.norm(errors, axis=1), estimate_robust_sigma(errors)
    return CameraFit(
        sigma_px,
        estimate_corner_noise_px(views, triples),
        rms_px=float(np.sqrt((lengths**2).mean())),
        far_share=float((lengths > FAR * sigma_px).mean()),
    )


def assess_fit(
    score: Score, rig_errors: RigErrors, triples: NDArray[np.int64], findings: Sequence[str] = ()
) -> FitQuality:
    """Assess a fit by its score and residuals; the given ``findings`` come before those made here."""
    cameras = compute_camera_fits(rig_errors, triples)
    far = _mask_far_off(rig_errors, cameras)
    return FitQuality(
        rms_over_median=score.rms_px / score.median_px if score.median_px > 0 else float("nan"),
        far_off_share=float(np.concatenate(list(far.values())).mean()),
        cameras=cameras,
        findings=(*findings, *(_describe_tail(score, rig_errors, far) or _describe_far_residuals(cameras))),
    )


def _describe_far_residuals(cameras: Mapping[str, CameraFit]) -> list[str]:
    """Return the finding that a part of some cameras' corners fits far worse than their noise."""
    far = {name: fit for name, fit in cameras.items() if fit.has_far_residuals}
    if not far:
        return []
    sizes = ", ".join(
        f"camera {name} {fit.rms_px:.3g} px RMS against {fit.corner_noise_px:.2g} px, though half of its corners fit "
        f"within {fit.sigma_px:.2g} px"
        for name, fit in far.items()
    )
    return [
        f"a part of the corners fits far worse than their noise ({sizes}): look at the arrows in the report; if they "
        "point outwards or inwards at the image's edge, the lens model does not hold there, else some views are bad"
    ]


def _mask_far_off(
    rig_errors: RigErrors, cameras: Mapping[str, CameraFit]
) -> dict[tuple[str, str], NDArray[np.bool_]]:
    """Return by camera and frame (n,) whether corners are far off."""
    return {
        (name, frame): np.linalg.norm(view.errors_px, axis=1) > FAR * cameras[name].sigma_px
        for name, views in rig_errors.residuals.items()
        for frame, view in views.items()
    }


def _describe_tail(
    score: Score, rig_errors: RigErrors, far: Mapping[tuple[str, str], NDArray[np.bool_]]
) -> list[str]:
    """Return the finding that some views fit far worse than the rest, with their names; empty if none do."""
    if score.rms_px < MAX_TAIL * score.median_px or score.rms_px < MIN_TAIL_PX:
        return []
    sizes = {(camera, frame): rig_errors.residuals[camera][frame].rms_px for camera, frame in far}
    worst = sorted(sizes, key=lambda view: -sizes[view])[:3]
    named = ", ".join(f"{camera} {frame} ({sizes[camera, frame]:.2g} px)" for camera, frame in worst)
    count, total = sum(int(f.sum()) for f in far.values()), sum(f.size for f in far.values())
    return [
        f"the RMS of {score.rms_px:.3g} px is {score.rms_px / score.median_px:.1f} times the median of "
        f"{score.median_px:.3g} px: {count} of {total} corners are far off, the worst views are {named}; look at "
        "them for blur, reflections, a moving board or one covered in part, and take them again or delete them"
    ]
