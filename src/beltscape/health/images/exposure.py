"""Exposure of the cameras: saturation, darkness, brightness against the other cameras, sunlight, flicker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.alarm_catalogue import EXPOSURE, FLICKER, LENS_COVERED, OVEREXPOSURE, SUNLIGHT
from beltscape.core.arrays import Float32Array
from beltscape.core.findings import Finding
from beltscape.core.statistics import MAD_TO_SIGMA, compute_median
from beltscape.core.translatable_message import make_message
from beltscape.health.image_statistics import ImageStatistics, find_place, remove_single_blocks
from beltscape.health.reference import (
    LEAST_SPECKLE,
    FrameStatistics,
    Reference,
    compare_cameras,
    has_projector,
    log_brightness,
    measure_speckle,
)
from beltscape.health.settings import HealthSettings

BLIND_SATURATION = 0.25
"""From this share of saturated pixels on an image is not matched (over-exposed × 20: 0.6; × 4: 0.03)."""
BLIND_DARKNESS = 0.1
"""Below this brightness over the other cameras', with hardly any light, a lens is covered."""
BLIND_LEVEL = 1.5
"""Below this brightness, of 255, rounding leaves nothing to match."""
_BRIGHTNESS_SIGMA = 0.1
"""One standard deviation of a sound camera's log brightness against the others': differing views of the scene."""
_SUNLIT = 2.0
"""Brightness over the median lit block from which a block without pattern is called sunlit."""
_FADED = 0.35
"""Contrast over the image's median below which a bright block has lost the pattern."""
_SAME = 0.06
"""Half the width of the densest eighth of the log ratios below which they are those of what does not move."""


def check_saturation(frame: FrameStatistics, settings: HealthSettings) -> list[Finding]:
    """Return the finding "overexposure" of every camera: its share of saturated pixels."""
    return [_check_saturation(name, one, settings.saturated) for name, one in frame.items()]


def _check_saturation(camera: str, one: ImageStatistics, limit: float) -> Finding:
    share = one.saturated_share
    finding = Finding(OVEREXPOSURE, 100 * share, 0.0, 100 * limit, "%", camera)
    if share <= limit:
        return finding
    text = make_message("overexposure", subject=camera, share=round(100 * share))
    effect = "missing" if share > BLIND_SATURATION else "degraded"
    return replace(finding, text=text, effect=effect, relative_sigma=share)


def check_brightness(
    frame: FrameStatistics, reference: Reference | None, settings: HealthSettings
) -> list[Finding]:
    """Return the findings "exposure" and "lens_covered" of every camera.

    The value is its brightness over that of the other cameras, in percent.
    """
    deviations = compare_cameras(frame, log_brightness)
    if reference is not None:
        for name in frame.keys() & reference.cameras.keys():
            deviations[name] -= reference.cameras[name].mean_level
    # with three cameras one wrong exposure moves the others' medians too: only the worst is accused
    worst = max(deviations, key=lambda name: abs(np.nan_to_num(deviations[name])))
    findings: list[Finding] = []
    for name, value in deviations.items():
        is_compared = len(frame) > 3 or name == worst
        findings.append(_check_exposure(name, frame[name], value, is_compared, settings))
        findings.append(_check_cover(name, frame[name], value, settings))
    return findings


def _check_exposure(
    camera: str, one: ImageStatistics, deviation: float, is_compared: bool, settings: HealthSettings
) -> Finding:
    factor = float(np.exp(deviation))
    limit = 100 / settings.brightness_factor if deviation < 0 else 100 * settings.brightness_factor
    finding = Finding(EXPOSURE, 100 * factor, 100 * factor * _BRIGHTNESS_SIGMA, limit, "%", camera)
    if one.mean_level < settings.dark_level:
        text = make_message("exposure_dark", subject=camera, level=round(one.mean_level, 1))
        effect = "missing" if one.mean_level < BLIND_LEVEL else "degraded"
        return replace(finding, text=text, effect=effect, relative_sigma=0.03)
    if is_compared and abs(deviation) > np.log(settings.brightness_factor):
        text = make_message("exposure_unequal", subject=camera, factor=float(f"{factor:.2g}"))
        return replace(finding, text=text, effect="degraded", relative_sigma=0.01)
    return finding


def _check_cover(camera: str, one: ImageStatistics, deviation: float, settings: HealthSettings) -> Finding:
    factor = float(np.exp(deviation))
    limit = 100 * BLIND_DARKNESS
    finding = Finding(LENS_COVERED, 100 * factor, 100 * factor * _BRIGHTNESS_SIGMA, limit, "%", camera)
    if factor > BLIND_DARKNESS or one.mean_level > settings.dark_level:
        return finding
    text = make_message("lens_covered", subject=camera, share=round(100 * factor, 1))
    return replace(finding, text=text, effect="missing")


def check_sunlight(frame: FrameStatistics, reference: Reference | None, settings: HealthSettings) -> Finding:
    """Return the finding "sunlight": the share of the picture that is bright and lacks the projected pattern.

    Without a projected pattern it is not measured.
    """
    speckled = measure_speckle(frame) > LEAST_SPECKLE
    if not (speckled if reference is None else has_projector(reference, settings)):
        return Finding(SUNLIGHT, float("nan"), float("nan"), 100 * settings.sunlight, "%")
    patches = {name: find_sunlit_blocks(one) for name, one in frame.items()}
    shares = {name: float(patch.mean()) for name, patch in patches.items()}
    share = float(np.median(list(shares.values())))
    camera = max(shares, key=lambda name: shares[name])
    values = 100 * share, 0.1, 100 * settings.sunlight
    if share <= settings.sunlight:
        return Finding(SUNLIGHT, *values, "%")
    text = make_message("sunlight", share=round(100 * share), camera=camera, most=round(100 * shares[camera]))
    return Finding(
        SUNLIGHT,
        *values,
        "%",
        "",
        text,
        "degraded",
        relative_sigma=share,
        place=find_place(patches[camera]),
    )


def find_sunlit_blocks(one: ImageStatistics) -> NDArray[np.bool_]:
    """Return the blocks of `GRID` that are far brighter than the picture and have lost the pattern."""
    patch = (one.level > _SUNLIT * compute_median(one.level)) & (one.contrasts < _FADED * one.contrast)
    return remove_single_blocks(patch)  # single blocks are glints or smooth stones


def measure_light_step(before: FrameStatistics, now: FrameStatistics) -> tuple[float, float]:
    """Return the logarithm of the light's change between two frames, and its σ; NaN without a common camera.

    The bare belt and all that does not move show the most frequent ratio of the blocks' levels. Where moving material
    covers everything, the ratios scatter, and their median is taken.
    """
    ratios = [
        compute_lit_ratios(now[name], before[name].level, before[name].exposure_us)
        for name in now.keys() & before.keys()
    ]
    if not ratios:
        return float("nan"), float("nan")
    pooled = np.concatenate(ratios)
    mode, width = estimate_mode(pooled)
    if width < _SAME:
        return mode, width / 4
    return float(np.median(pooled)), float(MAD_TO_SIGMA * np.median(np.abs(pooled - np.median(pooled))) / 10)


def compute_lit_ratios(one: ImageStatistics, level: Float32Array, exposure_us: float) -> Float32Array:
    """Return the logarithms of the light over that of earlier levels, (N,), in the blocks that were lit.

    ``exposure_us`` is the exposure time of the earlier levels: a longer one is no more light.
    """
    lit = level > 0.3 * compute_median(level)
    ratio = np.maximum(one.level[lit], 0.1) / np.maximum(level[lit], 0.1)
    return np.log(ratio * np.float32(exposure_us / one.exposure_us))


def estimate_mode(values: Float32Array) -> tuple[float, float]:
    """Return the half-sample mode (Bickel and Frühwirth 2006) of values, and half the width of the densest eighth."""
    ordered = np.sort(values)
    width = float("nan")
    while len(ordered) > 2:
        half = (len(ordered) + 1) // 2
        widths = ordered[half - 1 :] - ordered[: len(ordered) - half + 1]
        start = int(np.argmin(widths))
        if half >= len(values) // 8:
            width = float(widths[start]) / 2
        ordered = ordered[start : start + half]
    return float(ordered.mean()), width


def check_flicker(light: Sequence[float], sigma: float, settings: HealthSettings) -> Finding:
    """Return the finding "flicker": the change of the light against the median of the last frames.

    ``light`` is the logarithm of the light's brightness in the last frames, up to the sum of its steps.
    """
    change = float(np.exp(light[-1] - np.median(light[:-1]))) - 1 if len(light) > 1 else float("nan")
    values = 100 * change, 100 * sigma, 100 * settings.flicker
    if not abs(change) > settings.flicker:
        return Finding(FLICKER, *values, "%")
    return Finding(FLICKER, *values, "%", "", make_message("flicker", change=round(100 * change)))
