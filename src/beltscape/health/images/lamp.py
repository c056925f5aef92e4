"""The lamp's own light, from the amplitude of the projected pattern on what does not move; its ageing is a trend."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beltscape.core.alarm_catalogue import LAMP
from beltscape.core.arrays import Float32Array
from beltscape.core.findings import Finding
from beltscape.core.statistics import compute_median, drop_nan
from beltscape.core.translatable_message import make_message
from beltscape.health.image_statistics import ImageStatistics
from beltscape.health.images.exposure import estimate_mode
from beltscape.health.reference import CameraReference, FrameStatistics, Reference, has_projector
from beltscape.health.settings import HealthSettings

_AGED = 0.8
"""Share of the lamp's light below which it has aged: L80, a rated life of light sources (IEC 62717)."""
_DIMMED = 0.6
"""Share of all light instead, where no pattern tells the lamp from the hall's light."""
_SAME = 0.02
"""Half the width of the densest eighth of the log ratios up to which they are those of what does not move: 0.002 to
0.012 on a belt in view, from 0.032 where material covers it."""
_SIGMA_WIDTHS = 2.0
"""σ of the mode in these half widths: it errs by up to 1.6 % at a half width of 0.6 % in drawn images with noise."""
_LIGHT_SHARE = 0.25
"""Least fall of all light over the fall of the amplitude: 1 − the hall's share of the light, of which half is much. A
pattern out of focus, or seen through dust, loses amplitude without light."""


def check_lamp(
    frame: FrameStatistics,
    reference: Reference | None,
    light: float,
    light_sigma: float,
    settings: HealthSettings,
) -> Finding:
    """Return the finding "lamp": the lamp's light over that of the reference, percent; it warns of ageing.

    ``light`` is the logarithm of all light over that of the reference. The bare belt, its edges and all that does not
    move show the pattern with the amplitude that the lamp gives it, whatever the hall's light; material in motion
    shows any. Where it covers the view the lamp is not measured.
    """
    if reference is None or not has_projector(reference, settings) or not _has_amplitude(reference):
        return _describe(light, light_sigma, _DIMMED, can_be_lamp=True)
    amplitude, sigma = _measure_amplitude(frame, reference)
    fall = 1 - np.exp(amplitude)
    can_be_lamp = bool(1 - np.exp(light) > _LIGHT_SHARE * fall)
    return _describe(amplitude, sigma, _AGED, can_be_lamp=can_be_lamp)


def _has_amplitude(reference: Reference) -> bool:
    return any(np.isfinite(known.amplitude).any() for known in reference.cameras.values())


def _measure_amplitude(frame: FrameStatistics, reference: Reference) -> tuple[float, float]:
    """Return the logarithm of the pattern's amplitude over the reference and its σ; NaN where it is not visible."""
    ratios = [
        _compute_ratios(one, reference.cameras[name])
        for name, one in frame.items()
        if name in reference.cameras
    ]
    mode, width = estimate_mode(np.concatenate(ratios)) if ratios else (float("nan"), float("nan"))
    return (mode, _SIGMA_WIDTHS * width) if width <= _SAME else (float("nan"), float("nan"))


def _compute_ratios(one: ImageStatistics, known: CameraReference) -> Float32Array:
    """Return the logarithms of the amplitude over the reference, (N,), in the blocks that showed the pattern."""
    usual = known.amplitude > 0.5 * compute_median(drop_nan(known.amplitude))
    ratio = np.maximum(one.amplitude[usual], 0.1) / np.maximum(known.amplitude[usual], 0.1)
    return np.log(ratio * np.float32(known.exposure_us / one.exposure_us))


def _describe(log_share: float, sigma: float, limit: float, *, can_be_lamp: bool) -> Finding:
    value = 100 * float(np.exp(log_share))
    finding = Finding(LAMP, value, value * sigma, 100 * limit, "%")
    if not (can_be_lamp and value + 2 * value * sigma < 100 * limit):
        return finding
    return replace(finding, text=make_message("lamp", light=round(value)))
