"""Contrast and sharpness of a camera against the others: defocus, condensation or a film on a window."""

from __future__ import annotations

from statistics import median

import numpy as np

from beltscape.core.alarm_catalogue import CONDENSATION, DEFOCUS
from beltscape.core.findings import Effect, Finding
from beltscape.core.translatable_message import make_message
from beltscape.health.images.exposure import BLIND_DARKNESS
from beltscape.health.reference import (
    LEAST_CONTRAST,
    FrameStatistics,
    Reference,
    compare_cameras,
    log_brightness,
    log_contrast,
    log_shading,
    log_sharpness,
)
from beltscape.health.settings import HealthSettings

BLIND_CONTRAST = 0.1
"""Below this contrast over the other cameras' an image is not matched (blurred by σ 2 px: 0.08)."""
_SIGMA = 0.06
"""One standard deviation of a sound camera's log contrast against the others'."""
_BLUR = -0.4
"""A fall of the log sharpness from which a loss of contrast is defocus (σ 0.7 px: −0.55; any veil: −0.05)."""
FAINT_SIGNAL = 2.0
"""Below this texture over noise the sharpness is that of the noise."""
_VEIL = -0.2
"""A fall of the log spread between blocks from which a loss of contrast is a veil (0.4: −0.25; defocus: 0)."""
_PER_LOSS = 0.03
"""Relative error of the volume per unit of the core's log contrast (blurred by σ 2 px: 3.3 % at −2.5), doubled."""


def check_contrast(
    frame: FrameStatistics, reference: Reference | None, settings: HealthSettings
) -> list[Finding]:
    """Return the findings "defocus" and "condensation" of every camera, of which one at most is a fault.

    The value is its contrast over that of the other cameras, in percent. It is not measured where the others have no
    texture, nor for a black or saturated image.
    """
    contrast, sharpness, shading, mean_level = (
        compare_cameras(frame, value) for value in (log_contrast, log_sharpness, log_shading, log_brightness)
    )
    texture = median(one.contrast for one in frame.values())
    findings: list[Finding] = []
    for name in frame:
        known = None if reference is None else reference.cameras.get(name)
        offsets = (0.0, 0.0) if known is None else (known.contrast, known.sharpness)
        limit = settings.contrast_loss if known is None else settings.contrast_change
        change, blur = contrast[name] - offsets[0], sharpness[name] - offsets[1]
        veil = 0.0 if known is None else shading[name] - known.shading
        is_compared = (
            texture > LEAST_CONTRAST
            and mean_level[name] > np.log(BLIND_DARKNESS)
            and frame[name].saturated_share < settings.saturated
        )
        is_lost = is_compared and change < np.log(1 - limit)
        is_blurred = (blur < _BLUR or frame[name].signal_to_noise < FAINT_SIGNAL) and veil > _VEIL
        value = float(np.exp(change)) if is_compared else float("nan")
        faults = {DEFOCUS: is_lost and is_blurred, CONDENSATION: is_lost and not is_blurred}
        findings += [_describe(check, name, value, 1 - limit, is_fault) for check, is_fault in faults.items()]
    return findings


def _describe(check: str, camera: str, value: float, limit: float, is_fault: bool) -> Finding:
    values = 100 * value, 100 * value * _SIGMA, 100 * limit
    if not is_fault:
        return Finding(check, *values, "%", camera)
    text = make_message(check, subject=camera, contrast=round(100 * value))
    effect: Effect = "missing" if value < BLIND_CONTRAST else "degraded"
    sigma = _PER_LOSS * -float(np.log(value))
    return Finding(check, *values, "%", camera, text, effect, 0.0, sigma)
