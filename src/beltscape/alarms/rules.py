"""Readings → what they say of every alarm."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from beltscape.alarms.finding import Condition, Finding, above, below, told, worst
from beltscape.alarms.readings import Readings
from beltscape.alarms.settings import AlarmSettings
from beltscape.core.live import CameraHealth

Findings = Mapping[str, Finding]
"""By subject: a camera or a quantity; "" for the alarms that are about one thing only."""
Rule = Callable[[Readings, AlarmSettings], Findings]
_Kind = tuple[float, float, float | None, str]
"""Value, σ, limit (None: not set), unit."""

_NAN = float("nan")


def _overload(now: Readings, settings: AlarmSettings) -> Findings:
    own = settings.overload
    kinds = (
        *_lying(now, own.fill, own.area_mm2),
        (now.volume_flow_m3_h, now.volume_flow_sigma_m3_h, own.volume_flow_m3_h, "m³/h"),
        (now.mass_flow_t_h, now.mass_flow_sigma_t_h, own.mass_flow_t_h, "t/h"),
    )
    return {"": _any(kinds, lambda *one: above(*one, own.hysteresis, own.sigmas))}


def _empty(now: Readings, settings: AlarmSettings) -> Findings:
    own = settings.empty
    kinds = _lying(now, own.fill, own.area_mm2)
    return {"": _any(kinds, lambda *one: below(*one, own.hysteresis, own.sigmas))}


def _lying(now: Readings, fill: float | None, area_mm2: float | None) -> tuple[_Kind, _Kind]:
    """How much lies on the belt; its fill is no limit where the full belt's cross-section is not told."""
    if not math.isfinite(now.full_area_mm2):
        fill = None
    return (
        (100 * now.fill, 100 * now.fill_sigma, None if fill is None else 100 * fill, "%"),
        (now.area_mm2, now.area_sigma_mm2, area_mm2, "mm²"),
    )


def _any(kinds: Sequence[_Kind], judge: Callable[[float, float, float], Condition]) -> Finding:
    return worst(
        [
            Finding(judge(value, sigma, limit), value, limit, unit)
            for value, sigma, limit, unit in kinds
            if limit is not None
        ]
    )


def _belt_stopped(now: Readings, settings: AlarmSettings) -> Findings:
    own = settings.belt_stopped
    speed = abs(now.speed_mm_s)
    return {"": Finding(below(speed, 0, own.speed_mm_s, own.hysteresis), speed, own.speed_mm_s, "mm/s")}


def _oversize_lump(now: Readings, settings: AlarmSettings) -> Findings:
    own, size = settings.oversize_lump, now.largest_lump_mm
    if own.size_mm is None:
        return {}
    condition = above(size, now.largest_lump_sigma_mm, own.size_mm, own.hysteresis, own.sigmas)
    return {"": Finding(condition, size, own.size_mm, "mm")}


def _misaligned_belt(now: Readings, settings: AlarmSettings) -> Findings:
    own, offset = settings.misaligned_belt, now.belt_offset_mm
    condition = above(abs(offset), now.belt_offset_sigma_mm, own.offset_mm, own.hysteresis, own.sigmas)
    return {"": Finding(condition, offset, own.offset_mm, "mm")}


def _low_coverage(now: Readings, settings: AlarmSettings) -> Findings:
    own = settings.low_coverage
    condition = below(now.coverage, 0, own.coverage, own.hysteresis)
    return {"": Finding(condition, 100 * now.coverage, 100 * own.coverage, "%")}


def _camera_lost(now: Readings, settings: AlarmSettings) -> Findings:
    return {name: _camera(camera, settings) for name, camera in now.cameras.items()}


def _camera(camera: CameraHealth, settings: AlarmSettings) -> Finding:
    if camera.state == "ok":
        return Finding("off")
    delay = settings.camera_lost.waiting_s if camera.state == "waiting" else None
    return Finding("on", said=camera.message, after_s=delay)


def _camera_skew(now: Readings, settings: AlarmSettings) -> Findings:
    own, skew = settings.camera_skew, now.skew_ms
    return {"": Finding(above(skew, 0, own.skew_ms, own.hysteresis), skew, own.skew_ms, "ms")}


def _frames_dropped(now: Readings, settings: AlarmSettings) -> Findings:
    own, rate = settings.frames_dropped, now.dropped_per_minute
    return {"": Finding(above(rate, 0, own.per_minute, own.hysteresis), rate, own.per_minute, "/min")}


def _encoder_silent(now: Readings, settings: AlarmSettings) -> Findings:
    own, silent = settings.encoder_silent, now.encoder_silent_s
    return {"": Finding(above(silent, 0, own.silent_s, 0.5), silent, own.silent_s, "s")}


def _slip(now: Readings, settings: AlarmSettings) -> Findings:
    own, off = settings.slip, now.encoder_ratio - 1
    condition = above(abs(off), now.encoder_ratio_sigma, own.share, own.hysteresis, own.sigmas)
    return {"": Finding(condition, 100 * off, 100 * own.share, "%")}


def _no_measurement(now: Readings, settings: AlarmSettings) -> Findings:
    """The load first: where it is not measured, nothing is said of the others, for one cause is one alarm."""
    load = any(map(math.isfinite, (now.area_mm2, now.volume_flow_m3_h, now.mass_flow_t_h)))
    seldom = settings.no_measurement.seldom_after_s
    others = {
        "speed": (now.speed_mm_s, None, None),
        "lump": (now.largest_lump_mm, seldom, 0.0),
        "offset": (now.belt_offset_mm, seldom, 0.0),
    }
    found = {"load": Finding("off" if load else "on")}
    for name, (value, after_s, clear_after_s) in others.items():
        known = Finding("off" if math.isfinite(value) else "on", after_s=after_s, clear_after_s=clear_after_s)
        found[name] = known if load else Finding("unknown")
    return found


def _certificate_expiring(now: Readings, settings: AlarmSettings) -> Findings:
    own, days = settings.certificate_expiring, now.certificate_days
    return {"": Finding(below(days, 0, own.days, own.hysteresis), days, own.days, "d")}


RULES: Mapping[str, Rule] = {
    "no_measurement": _no_measurement,
    "overload": _overload,
    "oversize_lump": _oversize_lump,
    "misaligned_belt": _misaligned_belt,
    "belt_stopped": _belt_stopped,
    "empty": _empty,
    "low_coverage": _low_coverage,
    "camera_lost": _camera_lost,
    "camera_skew": _camera_skew,
    "frames_dropped": _frames_dropped,
    "disk_full": lambda now, _: {"": told(now.history_trouble)},
    "recording_paused": lambda now, _: {"": told(now.recording_trouble)},
    "encoder_silent": _encoder_silent,
    "encoder_wrong": lambda now, _: {"": told(now.encoder_trouble)},
    "slip": _slip,
    "certificate_expiring": _certificate_expiring,
}
"""Every alarm, in the order in which they are shown; each name is that of its settings."""
