"""Verdict on a calibrated rig: whether its figures are credible, and if not, which views are missing."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from beltscape.calibration.assessment.covariance import MIN_POSITIONS, RigCovariance, count_positions
from beltscape.calibration.assessment.fit_quality import CameraFit
from beltscape.calibration.assessment.remedy import PHOTOGRAPH, advise_views
from beltscape.calibration.assessment.score import Score
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.intrinsics.like_cameras import MAX_FOCAL, MIN_FOCAL, compute_coherence_factor
from beltscape.core.errors import CalibrationError

MAX_FOCAL_SIGMA = 0.03
"""Largest σ of a focal length, over it, of a credible rig: depths are uncertain by as much. Sound sets: 0.001.

Of 60 simulated sets of 3 to 5 frames, nearly square to the cameras, it refuses all that are off by more than 3 %.
"""
MAX_STATED_SIGMA = 0.3
"""Largest σ of a focal length, over it, that is stated: a larger one only says that the views do not measure it."""
MAX_RMS = 0.004
"""Largest RMS and median, over the image's diagonal, of a credible rig; webcams without a common trigger: 0.0009."""
FEW_POSITIONS, MAX_FEW_CHI2, MAX_FEW_PX = 5, 25.0, 0.3
"""With so few board positions, a camera whose residuals exceed its corners' noise by this variance ratio, and this σ
in px, is not credible: they do not suffice to average the excess. With more positions it is a finding, not an end."""


def require_credible(
    adjustment: BundleAdjustmentResult,
    covariance: RigCovariance,
    fits: Mapping[str, CameraFit],
    score: Score,
    training: Score,
) -> None:
    """Raise CalibrationError if the rig cannot be right, or is not determined; the line says which views are missing.

    ``fits`` and ``training`` belong to the views that the rig was found from; ``score`` is the held-out one, if any.
    """
    _require_plausible_lenses(adjustment)
    _require_determined_lenses(adjustment, covariance)
    _require_small_residuals(adjustment, fits, score, training)


def compute_focal_sigma(adjustment: BundleAdjustmentResult, covariance: RigCovariance) -> dict[str, float]:
    """Return by camera σ of the focal length in the joint adjustment, px.

    It contains the noise of the corners, and the scatter of this focal length if positions of the board are left out
    in turn, which shows errors that corners share; few positions enlarge it. With fewer than three positions a view
    counts as one homography, whatever the number of its corners.
    """
    sigma = np.sqrt(np.diag(covariance.matrix)) / covariance.inflation
    result: dict[str, float] = {}
    for index, name in enumerate(adjustment.rig.cameras):
        columns = [covariance.parameters.index(f"{name}.{key}") for key in ("fx_px", "fy_px")]
        formal, count = float(sigma[columns].max()), covariance.positions
        if count < MIN_POSITIONS:
            result[name] = formal * _compute_coherence_factor(adjustment, index)
        else:
            scatter = float(covariance.scatter[columns].max())
            result[name] = float(np.hypot(formal, scatter) * np.sqrt(count / (count - 2)))
    return result


def _compute_coherence_factor(adjustment: BundleAdjustmentResult, camera: int) -> float:
    """Return the factor by which σ from independent corners is too small if a view's errors are alike."""
    observed = adjustment.bundle.observations
    own = adjustment.used & (observed.camera == camera)
    return compute_coherence_factor(int(own.sum()), len(np.unique(observed.frame[own])))


def _require_plausible_lenses(adjustment: BundleAdjustmentResult) -> None:
    for name, camera in adjustment.rig.cameras.items():
        focal = float(camera.focal_px.min())
        if not MIN_FOCAL * max(camera.size_px) < focal < MAX_FOCAL * max(camera.size_px):
            raise CalibrationError(
                f"camera {name}: the views lead to a focal length of {focal:.4g} px, which no lens of an image "
                f"{camera.size_px[0]} px wide has; {advise_views(adjustment)}"
            )


def _require_determined_lenses(adjustment: BundleAdjustmentResult, covariance: RigCovariance) -> None:
    sigma = compute_focal_sigma(adjustment, covariance)
    focal = {name: float(camera.focal_px.mean()) for name, camera in adjustment.rig.cameras.items()}
    loose = [name for name in sigma if not sigma[name] < MAX_FOCAL_SIGMA * focal[name]]
    if loose:
        sizes = ", ".join(f"{name} {_describe_focal(focal[name], sigma[name])}" for name in loose[:4])
        more = f" and {len(loose) - 4} more" if len(loose) > 4 else ""
        raise CalibrationError(
            f"the views do not determine the focal length of camera {sizes}{more}: "
            f"{advise_views(adjustment)}, or give known intrinsics"
        )


def _describe_focal(focal: float, sigma: float) -> str:
    """Return a focal length with its σ in words."""
    if not sigma < MAX_STATED_SIGMA * focal:
        return "not measurable"
    return f"{focal:.0f} ± {sigma:.0f} px"


def _require_small_residuals(
    adjustment: BundleAdjustmentResult, fits: Mapping[str, CameraFit], score: Score, training: Score
) -> None:
    diagonal = min(float(np.hypot(*camera.size_px)) for camera in adjustment.rig.cameras.values())
    for each, kind in ((training, "its own"), (score, "held-out")):
        if min(each.median_px, each.rms_px / 2) > MAX_RMS * diagonal:
            raise CalibrationError(
                f"the rig contradicts {kind} views by {each.median_px:.3g} px in the median: the cameras are not "
                f"triggered together, one of them moved, or board.toml describes another board; correct that, then "
                f"{PHOTOGRAPH}"
            )
    positions = count_positions(adjustment)
    worst = max(fits, key=lambda name: fits[name].sigma_px, default=None)
    if worst is None or positions > FEW_POSITIONS:
        return
    if fits[worst].sigma_px > MAX_FEW_PX and fits[worst].chi2_per_dof > MAX_FEW_CHI2:
        raise CalibrationError(
            f"camera {worst} misses its corners by {fits[worst].sigma_px:.2g} px where they are certain to "
            f"{fits[worst].corner_noise_px:.2g} px, which is not noise; "
            f"{advise_views(adjustment)}"
        )
