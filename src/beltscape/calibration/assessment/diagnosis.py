"""Diagnosis of a calibrated rig after the joint adjustment: findings, notes, and what was left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.assessment.findings.discards import Discards, find_discards
from beltscape.calibration.assessment.findings.fit_findings import list_calibration_findings
from beltscape.calibration.assessment.findings.retest import retest_network
from beltscape.calibration.assessment.findings.verdict import require_credible
from beltscape.calibration.assessment.uncertainty.covariance import RigCovariance
from beltscape.calibration.assessment.validation.cross_validation import CrossValidation
from beltscape.calibration.assessment.validation.fit_quality import compute_camera_fits
from beltscape.calibration.assessment.validation.score import RigErrors, summarise_errors
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.hierarchy import HierarchyResult
from beltscape.calibration.network.association import CameraNetwork


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """Diagnosis of a calibration by its final rig."""

    findings: tuple[str, ...]
    """Faults, the likeliest cause first; empty for a sound calibration."""
    notes: tuple[str, ...]
    """What looked like a fault before the joint adjustment and is none, and other remarks."""
    discards: Discards
    network: CameraNetwork
    """The camera network as tested last."""


def diagnose(
    hierarchy: HierarchyResult,
    adjustment: BundleAdjustmentResult,
    covariance: RigCovariance,
    triples: NDArray[np.int64],
    rig_errors: RigErrors,
    validation: CrossValidation | None,
    *,
    explained: Sequence[str] = (),
) -> Diagnosis:
    """Diagnose a calibration by its final rig; ``triples`` (n, 3) are corners in a row of the board.

    The misfit of the ``explained`` cameras has been reported already.

    Raises
    ------
    CalibrationError
        When the rig is not credible; the line says which views are missing.
    """
    fits, training = compute_camera_fits(rig_errors, triples), summarise_errors(rig_errors)
    if not explained:
        score = validation.score if validation else training
        require_credible(adjustment, covariance, fits, score, training)
    retest = retest_network(hierarchy, adjustment)
    findings = list_calibration_findings(retest.hierarchy, fits, validation, training, explained=explained)
    discards = find_discards(hierarchy, adjustment)
    return Diagnosis(
        tuple(findings), (*retest.notes, *describe_pixels(adjustment)), discards, retest.hierarchy.network
    )


SQUARE_TOLERANCE = 0.01
"""Share by which fx and fy differ from which on pixels are not square; those of sensors are within 0.001."""


def describe_pixels(adjustment: BundleAdjustmentResult) -> list[str]:
    """Return a remark on each camera whose pixels are not square."""
    return [
        f"camera {name}: its pixels are not square, fx/fy = {ratio:.3f}: its images were stretched, or rows or "
        "columns are skipped; that is allowed if all later images are alike"
        for name, camera in adjustment.rig.cameras.items()
        if abs((ratio := float(camera.focal_px[0] / camera.focal_px[1])) - 1) > SQUARE_TOLERANCE
    ]
