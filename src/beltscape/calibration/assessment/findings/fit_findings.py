"""Findings against a calibration's fit, each in one line with the likely reason and the fix."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from beltscape.calibration.assessment.validation.cross_validation import CrossValidation
from beltscape.calibration.assessment.validation.fit_quality import CameraFit
from beltscape.calibration.assessment.validation.score import Score
from beltscape.calibration.hierarchy import HierarchyResult, find_unsynchronised_pairs
from beltscape.calibration.network.association import Misclosure
from beltscape.calibration.network.fault_isolation import describe_fault
from beltscape.core.geometry.camera import Camera

MAX_CHI2, MIN_OPEN_PX = 6.0, 0.25
"""A path or loop is open if its χ² per degree of freedom and its angle in the image exceed these.

Sound sets have at most 1.2 and 0.01 px, blurred or asynchronous views 18 to 440 and 1 to 20 px.
"""
MAX_OVERFIT, MIN_OVERFIT_PX = 1.5, 0.1
"""The views are too few if held-out over training RMS, and their difference, exceed these; sound: below 1.12."""


def list_calibration_findings(
    hierarchy: HierarchyResult,
    fits: Mapping[str, CameraFit],
    halves: CrossValidation | None,
    training: Score,
    *,
    explained: Sequence[str] = (),
) -> list[str]:
    """Return the findings against a calibration, the likeliest cause first; empty for a sound one.

    The misfit of the ``explained`` cameras has been reported already.
    """
    alone = {name: fit for name, fit in fits.items() if name not in explained}
    causes = [*_find_asynchronous(hierarchy), *_find_fault(hierarchy), *_find_own_misfit(hierarchy, alone)]
    if not causes and not explained:
        causes = describe_pattern([name for name, fit in fits.items() if fit.is_pattern()], fits, TOGETHER)
    return [*causes, *_find_open_loops(hierarchy), *_find_overfit(halves, training)]


def list_network_findings(hierarchy: HierarchyResult) -> list[str]:
    """Return the findings of pairs, of the loops' fault isolation, and of open loops."""
    return [*_find_asynchronous(hierarchy), *_find_fault(hierarchy), *_find_open_loops(hierarchy)]


TOGETHER = (
    "the cameras do not fit together: they are not triggered at the same instant, or one of them moved between "
    "views; check trigger and mounts"
)
ALONE = (
    "the lens model or the board does not explain the views: look for a wide-angle lens, a board that bends, views "
    "out of focus, motion blur or a rolling shutter, and take new views of a rigid board that stands still"
)


def describe_pattern(names: Sequence[str], fits: Mapping[str, CameraFit], reason: str) -> list[str]:
    """Return the finding that residuals of these cameras are more than noise; empty without a camera."""
    if not names:
        return []
    sizes = ", ".join(
        f"camera {name} {fits[name].sigma_px:.2g} px against {fits[name].corner_noise_px:.2g} px"
        for name in names
    )
    return [f"residuals are a pattern, far larger than the corners' own noise ({sizes}): {reason}"]


def _find_asynchronous(hierarchy: HierarchyResult) -> list[str]:
    """Return the finding that pairs fit worse than their cameras alone."""
    unsynchronised = find_unsynchronised_pairs(hierarchy)
    if not unsynchronised:
        return []
    sizes = ", ".join(f"{pair.first}–{pair.second} {pair.rms_px:.2f} px" for pair in unsynchronised)
    alone = max(
        hierarchy.monocular[name].rms_px for pair in unsynchronised for name in (pair.first, pair.second)
    )
    return [
        f"cameras fit worse together than alone (at most {alone:.2f} px): {sizes}; they are not triggered at the "
        "same instant, or one of them moved"
    ]


def _find_fault(hierarchy: HierarchyResult) -> list[str]:
    """Return the finding of the camera or pair whose loops are open."""
    fault = describe_fault(hierarchy.network)
    return [] if fault is None else [fault]


def _find_own_misfit(hierarchy: HierarchyResult, fits: Mapping[str, CameraFit]) -> list[str]:
    """Return the finding that cameras do not fit their own views, independently of the other cameras."""
    own_fits = {
        name: CameraFit(hierarchy.monocular[name].rms_px / np.sqrt(2), fit.corner_noise_px)
        for name, fit in fits.items()
    }
    return describe_pattern(
        [name for name in fits if own_fits[name].is_pattern() and fits[name].is_pattern()], own_fits, ALONE
    )


def _find_open_loops(hierarchy: HierarchyResult) -> list[str]:
    """Return the finding of open paths and loops, with the one that closes worst."""
    network = hierarchy.network
    errors = (*network.path_errors, *network.loop_errors)
    open_ones = [
        error
        for error in errors
        if error.chi2_per_dof > MAX_CHI2
        and _compute_angle_px(error, (hierarchy.rig.cameras[n] for n in error.cameras)) > MIN_OPEN_PX
    ]
    if not open_ones:
        return []
    worst = max(open_ones, key=lambda error: error.chi2_per_dof)
    return [
        f"{len(open_ones)} of {len(errors)} paths and loops of the camera network do not close: worst "
        f"{'–'.join(worst.cameras)} with χ² {worst.chi2_per_dof:.1f} per degree of freedom (1 where noise explains "
        f"it), {worst.rotation_deg:.2g}° and {worst.translation_mm:.2g} mm"
    ]


def _compute_angle_px(error: Misclosure, cameras: Iterable[Camera]) -> float:
    """Return a misclosure's rotation as a shift in the images, px."""
    return float(np.deg2rad(error.rotation_deg) * max(camera.focal_px.mean() for camera in cameras))


def _find_overfit(halves: CrossValidation | None, training: Score) -> list[str]:
    """Return the finding that views are too few or too alike."""
    if halves is None:
        return []
    rms_px = halves.score.rms_px
    if rms_px < MAX_OVERFIT * training.rms_px or rms_px - training.rms_px < MIN_OVERFIT_PX:
        return []
    return [
        f"on held-out views the RMS is {rms_px:.3g} px, {rms_px / training.rms_px:.1f} times the "
        f"{training.rms_px:.3g} px on the views the rig was found from: these are too few or too alike; add views "
        "with the board tilted to every side and in every corner of the images"
    ]
