"""The projected pattern in all cameras at once: projector off, dim or out of focus; dust in the air."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from beltscape.core.alarm_catalogue import DUST, PROJECTOR, PROJECTOR_FOCUS
from beltscape.core.findings import Effect, Finding
from beltscape.core.statistics import compute_quantile, drop_nan
from beltscape.core.translatable_message import make_message
from beltscape.health.image_statistics import ImageStatistics
from beltscape.health.images.exposure import compute_lit_ratios, estimate_mode
from beltscape.health.images.sharpness import FAINT_SIGNAL
from beltscape.health.reference import (
    LEAST_SPECKLE,
    CameraReference,
    FrameStatistics,
    Reference,
    has_projector,
    log_contrast,
    log_shading,
    log_sharpness,
)
from beltscape.health.settings import HealthSettings

BLIND_CONTRAST = 0.25
"""Below this contrast over the reference nothing is matched: only chance matches remain."""
_DIM = -0.3
"""A fall of the log light that goes with a dimmed projector; dust in the air scatters light and brightens."""
_BLUR = -0.4
"""A fall of the log sharpness in all cameras that makes the projector out of focus; dust: −0.05."""
_VEIL = -0.2
"""A fall of the log spread between blocks that a veil causes, but not defocus."""
_DARK_LIGHT = 0.5
"""Below this light over the reference a projector is called dim, whatever the contrast."""
_LEAST_SIGNAL = 1.5
"""Below this texture over noise in most cameras nothing can be matched (bare rubber in ambient light: 1.9)."""
_SAME_LOSS = 0.3
"""Largest difference of the log losses of contrast and of the spread between blocks by a veil; dust: 0.21."""
_BRIGHTER = 0.2
"""Least rise of the log brightness of the dark blocks by a veil; dust: 0.7, other faults up to 0.16."""
_DARKEST = 0.1
"""Share of the blocks that count as dark: floor, belt's edges and shadows, in any scene."""
_DARK_CONTRAST, _DARK_LEVEL = 0.5, 0.75
"""Contrast and brightness of a block over the reference below which it is dark: material in the pattern keeps the
contrast, a pattern out of focus the brightness. Chosen, far from sound captures' contrast (0.97)."""
_LEAST_PART = 0.12
"""Least share of the pattern's blocks that is called a dark part; shadows of a heap differ between cameras."""
_SOUND_REST = 0.8
"""Least contrast of the other blocks over the reference beside a dark part; else the whole pattern has changed."""
_PER_PART = 0.2
"""Relative error of the volume per share of the pattern that is dark, where heights are filled in. Chosen."""
_SIGMA = 0.05
"""One standard deviation of the median log contrast of a sound system: other material reflects otherwise."""


def check_projected_pattern(
    frame: FrameStatistics, reference: Reference | None, light: float, settings: HealthSettings
) -> list[Finding]:
    """Return the findings "projector", "projector_focus" and "dust", of which one at most is a fault.

    ``light`` is the logarithm of the light's brightness over that of the reference. The value is the pattern's
    contrast over that of the reference in percent; without a projected pattern it is not measured.
    """
    limit = 100 * (1 - settings.pattern_loss)
    if reference is None or not has_projector(reference, settings):
        without = _check_without_reference(frame, limit, settings)
        return [without, *_pass((PROJECTOR_FOCUS,), limit), _check_veil(frame, reference, limit, settings)]
    change = _compare_with_reference(frame, reference, settings)
    if change is None:
        return _pass((PROJECTOR, PROJECTOR_FOCUS, DUST), limit)
    part = _measure_dark_part(frame, reference)
    if part > _LEAST_PART:
        return [_describe_part(part, limit), *_pass((PROJECTOR_FOCUS, DUST), limit)]
    fault = _name_fault(change, light, settings)
    value = float(np.exp(change.contrast))
    return [
        _describe(check, value, float(np.exp(light)), limit, check == fault)
        for check in (PROJECTOR, PROJECTOR_FOCUS, DUST)
    ]


@dataclass(frozen=True, slots=True)
class _Change:
    """Median change of the cameras against their reference; logarithms."""

    contrast: float
    sharpness: float
    shading: float
    signal_to_noise: float
    """Texture over noise, no logarithm."""
    dark_level: float
    """Brightness of the darkest tenth of the blocks."""


def _compare_with_reference(
    frame: FrameStatistics, reference: Reference, settings: HealthSettings
) -> _Change | None:
    """Return the change of the cameras that are not saturated; None if there is none."""
    pairs = [
        (one, reference.cameras[name])
        for name, one in frame.items()
        if name in reference.cameras and one.saturated_share < settings.saturated
    ]
    if not pairs:
        return None
    return _Change(
        median(log_contrast(one) - known.own_contrast for one, known in pairs),
        median(log_sharpness(one) - known.own_sharpness for one, known in pairs),
        median(log_shading(one) - known.own_shading for one, known in pairs),
        median(one.signal_to_noise for one, _ in pairs),
        median(_compare_dark_level(one, known) for one, known in pairs),
    )


def _compare_dark_level(one: ImageStatistics, known: CameraReference) -> float:
    """Return the logarithm of the darkest blocks' brightness over the reference, at the same exposure time."""
    now, before = (compute_quantile(drop_nan(level), _DARKEST) for level in (one.level, known.level))
    return float(np.log(max(now, 0.1) / max(before, 0.1) * known.exposure_us / one.exposure_us))


def _name_fault(change: _Change, light: float, settings: HealthSettings) -> str:
    """Return the check whose fault explains the change; empty for a change within the limits."""
    if light < np.log(_DARK_LIGHT):
        return PROJECTOR
    if change.contrast > np.log(1 - settings.pattern_loss):
        return ""
    if light < _DIM:
        return PROJECTOR
    is_faint = change.signal_to_noise < FAINT_SIGNAL and change.shading > _VEIL
    return PROJECTOR_FOCUS if change.sharpness < _BLUR or is_faint else DUST


def _describe(check: str, contrast: float, light: float, limit: float, is_fault: bool) -> Finding:
    values = 100 * contrast, 100 * contrast * _SIGMA, limit
    if not is_fault:
        return Finding(check, *values, "%")
    effect: Effect = "missing" if contrast < BLIND_CONTRAST else "degraded"
    state = "off" if effect == "missing" else "dim"
    key = f"projector_{state}" if check == PROJECTOR else check
    text = make_message(key, contrast=round(100 * contrast), light=round(100 * light))
    return Finding(check, *values, "%", "", text, effect, 0.0, 0.03 - 0.02 * float(np.log(min(contrast, 1))))


def _measure_dark_part(frame: FrameStatistics, reference: Reference) -> float:
    """Return the share of the pattern that is dark in most cameras while the rest is sound; 0 where it is not."""
    parts: list[float] = []
    for name, one in frame.items():
        known = reference.cameras.get(name)
        if known is None or not np.isfinite(known.amplitude).all():
            continue
        usual = known.amplitude / np.maximum(known.level, 1)
        lit = usual > LEAST_SPECKLE
        if not lit.any():
            continue
        contrast = (one.contrasts / np.maximum(usual, 1e-3))[lit]
        level = (one.level * (known.exposure_us / one.exposure_us) / np.maximum(known.level, 1))[lit]
        dark = (contrast < _DARK_CONTRAST) & (level < _DARK_LEVEL)
        is_rest_sound = not dark.all() and float(np.median(contrast[~dark])) > _SOUND_REST
        parts.append(float(dark.mean()) if is_rest_sound else 0.0)
    return median(parts) if parts else 0.0


def _describe_part(part: float, limit: float) -> Finding:
    text = make_message("projector_part", part=round(100 * part))
    value = 100 * (1 - part)
    return Finding(PROJECTOR, value, 100 * _SIGMA, limit, "%", "", text, "degraded", 0.0, _PER_PART * part)


def is_partly_dark(findings: Sequence[Finding]) -> bool:
    """Return whether a part of the pattern is dark, which changes the contrast of the cameras' images."""
    return any(one.cause == "projector_part" for one in findings)


def _check_without_reference(frame: FrameStatistics, limit: float, settings: HealthSettings) -> Finding:
    """Return the finding "projector" of a frame in which no camera shows texture above its noise."""
    signal = median(one.signal_to_noise for one in frame.values())
    nan = float("nan")
    if settings.projector == "no" or signal > _LEAST_SIGNAL:
        return Finding(PROJECTOR, nan, nan, limit, "%")
    return Finding(PROJECTOR, nan, nan, limit, "%", "", make_message("no_texture"), "missing")


def _check_veil(
    frame: FrameStatistics, reference: Reference | None, limit: float, settings: HealthSettings
) -> Finding:
    """Return the finding "dust" where no pattern is resolved: a veil in most cameras, whatever the material.

    A veil of scattered light takes the same share of the contrast and of the spread between blocks, and brightens
    the dark blocks. Another material or an empty belt changes some of these, but not all in this way.
    """
    nan = float("nan")
    if reference is None:
        return Finding(DUST, nan, nan, limit, "%")
    change = _compare_with_reference(frame, reference, settings)
    if change is None:
        return Finding(DUST, nan, nan, limit, "%")
    is_alike = abs(change.contrast - change.shading) < _SAME_LOSS
    is_lost = max(change.contrast, change.shading) < np.log(1 - settings.pattern_loss)
    value = float(np.exp(max(change.contrast, change.shading)))
    if not (is_alike and is_lost and change.dark_level > _BRIGHTER):
        return Finding(DUST, nan, nan, limit, "%")
    text = make_message("dust_veil", contrast=round(100 * value))
    return Finding(DUST, 100 * value, 100 * value * _SIGMA, limit, "%", "", text, "degraded", 0.0, 0.03)


def _pass(checks: tuple[str, ...], limit: float) -> list[Finding]:
    return [Finding(check, float("nan"), float("nan"), limit, "%") for check in checks]


def measure_light(frame: FrameStatistics, reference: Reference) -> tuple[float, float]:
    """Return the logarithm of the bare belt's brightness over the reference, and its σ; NaN without a reference.

    The bare belt is the most frequent ratio of brightness over all blocks; material is brighter or darker.
    """
    ratios = [
        compute_lit_ratios(one, reference.cameras[name].level, reference.cameras[name].exposure_us)
        for name, one in frame.items()
        if name in reference.cameras
    ]
    return estimate_mode(np.concatenate(ratios)) if ratios else (float("nan"), float("nan"))
