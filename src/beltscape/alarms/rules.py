"""The rules of the alarms: readings and settings to the condition of every alarm."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from beltscape.alarms.readings import Readings
from beltscape.alarms.settings import AlarmSettings
from beltscape.alarms.state_machine import (
    AlarmCondition,
    ConditionState,
    compare_lower,
    compare_upper,
    condition_from_text,
    select_worst,
)
from beltscape.core.alarm_catalogue import (
    BELT_STOPPED,
    CAMERA_LOST,
    CAMERA_SKEW,
    CAMERAS_OFF,
    CERTIFICATE_EXPIRING,
    DISK_FULL,
    EMPTY,
    ENCODER_SILENT,
    ENCODER_WRONG,
    FRAMES_DROPPED,
    GPU_LOST,
    HISTORY_REPAIRED,
    KINDS,
    LOW_COVERAGE,
    MATERIAL_TEST_DUE,
    MISALIGNED_BELT,
    NO_MEASUREMENT,
    OVERLOAD,
    OVERSIZE_LUMP,
    RECORDING_PAUSED,
    REPORTS_FAILING,
    TEST_CERTIFICATE_VOID,
    USERS_UNREADABLE,
)
from beltscape.core.events import CameraHealth
from beltscape.core.translatable_message import make_message

Conditions = Mapping[str, AlarmCondition]
"""By subject: a camera or a quantity; "" for the alarms that have only one subject."""
Rule = Callable[[Readings, AlarmSettings], Conditions]
_LimitedValue = tuple[float, float, float | None, str]
"""Value, σ, limit (None: not set), unit."""

_NAN = float("nan")


def _overload(now: Readings, settings: AlarmSettings) -> Conditions:
    own = settings.overload
    limited = (
        *_limited_loads(now, own.fill, own.area_mm2),
        (now.volume_flow_m3_h, now.volume_flow_sigma_m3_h, own.volume_flow_m3_h, "m³/h"),
        (now.mass_flow_t_h, now.mass_flow_sigma_t_h, own.mass_flow_t_h, "t/h"),
    )
    compare = partial(compare_upper, hysteresis=own.hysteresis, sigmas=own.sigmas)
    return {"": _worst_of(limited, compare)}


def _empty(now: Readings, settings: AlarmSettings) -> Conditions:
    own = settings.empty
    limited = _limited_loads(now, own.fill, own.area_mm2)
    compare = partial(compare_lower, hysteresis=own.hysteresis, sigmas=own.sigmas)
    return {"": _worst_of(limited, compare)}


def _limited_loads(
    now: Readings, fill: float | None, area_mm2: float | None
) -> tuple[_LimitedValue, _LimitedValue]:
    """Return fill and area of the load with their limits; without the full belt's cross-section fill has none."""
    if not math.isfinite(now.full_area_mm2):
        fill = None
    return (
        (100 * now.fill, 100 * now.fill_sigma, None if fill is None else 100 * fill, "%"),
        (now.area_mm2, now.area_sigma_mm2, area_mm2, "mm²"),
    )


def _worst_of(
    limited: Sequence[_LimitedValue], compare: Callable[[float, float, float], ConditionState]
) -> AlarmCondition:
    return select_worst(
        [
            AlarmCondition(compare(value, sigma, limit), value, limit, unit)
            for value, sigma, limit, unit in limited
            if limit is not None
        ]
    )


def _belt_stopped(now: Readings, settings: AlarmSettings) -> Conditions:
    own = settings.belt_stopped
    speed = abs(now.speed_mm_s)
    state = compare_lower(speed, 0, own.speed_mm_s, own.hysteresis)
    return {"": AlarmCondition(state, speed, own.speed_mm_s, "mm/s")}


def _oversize_lump(now: Readings, settings: AlarmSettings) -> Conditions:
    own, size = settings.oversize_lump, now.largest_lump_mm
    if own.size_mm is None:
        return {}
    state = compare_upper(size, now.largest_lump_sigma_mm, own.size_mm, own.hysteresis, own.sigmas)
    return {"": AlarmCondition(state, size, own.size_mm, "mm")}


def _misaligned_belt(now: Readings, settings: AlarmSettings) -> Conditions:
    own, offset = settings.misaligned_belt, now.belt_offset_mm
    state = compare_upper(abs(offset), now.belt_offset_sigma_mm, own.offset_mm, own.hysteresis, own.sigmas)
    return {"": AlarmCondition(state, offset, own.offset_mm, "mm")}


def _low_coverage(now: Readings, settings: AlarmSettings) -> Conditions:
    own = settings.low_coverage
    state = compare_lower(now.coverage, 0, own.coverage, own.hysteresis)
    return {"": AlarmCondition(state, 100 * now.coverage, 100 * own.coverage, "%")}


def _cameras_off(now: Readings, settings: AlarmSettings) -> Conditions:
    """Return the conditions by bank; a bank of one camera, or with a camera that is not known, has none."""
    banks = settings.cameras_off.banks or {"": tuple(now.cameras)}
    return {
        bank: _bank([now.cameras[name] for name in names], settings)
        for bank, names in banks.items()
        if len(names) > 1 and all(name in now.cameras for name in names)
    }


def _bank(cameras: Sequence[CameraHealth], settings: AlarmSettings) -> AlarmCondition:
    if any(camera.state not in ("lost", "waiting") for camera in cameras):
        return AlarmCondition("off")
    is_waiting = any(camera.state == "waiting" for camera in cameras)
    return AlarmCondition("on", after_s=settings.cameras_off.waiting_s if is_waiting else None)


def _camera_lost(now: Readings, settings: AlarmSettings) -> Conditions:
    return {name: _camera(camera, settings) for name, camera in now.cameras.items()}


def _camera(camera: CameraHealth, settings: AlarmSettings) -> AlarmCondition:
    if camera.state == "ok":
        return AlarmCondition("off")
    delay = settings.camera_lost.waiting_s if camera.state == "waiting" else None
    return AlarmCondition("on", text=camera.message, after_s=delay)


def _camera_skew(now: Readings, settings: AlarmSettings) -> Conditions:
    own, skew = settings.camera_skew, now.skew_ms
    return {"": AlarmCondition(compare_upper(skew, 0, own.skew_ms, own.hysteresis), skew, own.skew_ms, "ms")}


def _frames_dropped(now: Readings, settings: AlarmSettings) -> Conditions:
    own, rate, held = settings.frames_dropped, now.dropped_per_minute, now.capacity
    state = compare_upper(rate, 0, own.per_minute, own.hysteresis)
    text = ""
    if state == "on" and math.isfinite(held.sets_per_s):
        text = make_message(
            "frames_dropped",
            dropped=round(rate),
            rate=float(f"{held.sets_per_s:.2g}"),
            speed=float(f"{held.speed_mm_s * 1e-3:.2g}"),
        )
    return {"": AlarmCondition(state, rate, own.per_minute, "/min", text)}


def _encoder_silent(now: Readings, settings: AlarmSettings) -> Conditions:
    own, silent = settings.encoder_silent, now.encoder_silent_s
    return {"": AlarmCondition(compare_upper(silent, 0, own.silent_s, 0.5), silent, own.silent_s, "s")}


def _no_measurement(now: Readings, settings: AlarmSettings) -> Conditions:
    """Return the conditions by quantity; without a load the others are unknown: one cause raises one alarm."""
    load = any(map(math.isfinite, (now.area_mm2, now.volume_flow_m3_h, now.mass_flow_t_h)))
    periodic_s = settings.no_measurement.seldom_after_s
    others = {
        "speed": (now.speed_mm_s, None, None),
        "lump": (now.largest_lump_mm, periodic_s, 0.0),
        "offset": (now.belt_offset_mm, periodic_s, 0.0),
    }
    conditions = {"load": AlarmCondition("off" if load else "on")}
    for name, (value, after_s, clear_after_s) in others.items():
        state: ConditionState = "off" if math.isfinite(value) else "on"
        condition = AlarmCondition(state, after_s=after_s, clear_after_s=clear_after_s)
        conditions[name] = condition if load else AlarmCondition("unknown")
    return conditions


def _certificate_expiring(now: Readings, settings: AlarmSettings) -> Conditions:
    own, days = settings.certificate_expiring, now.certificate_days
    return {"": AlarmCondition(compare_lower(days, 0, own.days, own.hysteresis), days, own.days, "d")}


def _material_test_due(now: Readings, settings: AlarmSettings) -> Conditions:
    """Return the condition; a plant without a certificate has none."""
    own, found = settings.material_test_due, now.test_certificate
    if found is None:
        return {}
    days = found.days_left
    text = make_message("material_test_overdue", days=max(1, round(-days))) if days < 0 else ""
    return {"": AlarmCondition(compare_lower(days, 0, own.days, own.hysteresis), days, own.days, "d", text)}


def _test_certificate_void(now: Readings, settings: AlarmSettings) -> Conditions:  # noqa: ARG001
    """Return the condition; its line names the first part that has changed."""
    found = now.test_certificate
    if found is None:
        return {}
    if not found.changed:
        return {"": AlarmCondition("off")}
    text = make_message(f"test_certificate_{found.changed[0]}", number=found.number)
    return {"": AlarmCondition("on", text=text)}


_RULES: Mapping[str, Rule] = {
    NO_MEASUREMENT: _no_measurement,
    OVERLOAD: _overload,
    OVERSIZE_LUMP: _oversize_lump,
    MISALIGNED_BELT: _misaligned_belt,
    BELT_STOPPED: _belt_stopped,
    EMPTY: _empty,
    LOW_COVERAGE: _low_coverage,
    CAMERAS_OFF: _cameras_off,
    CAMERA_LOST: _camera_lost,
    CAMERA_SKEW: _camera_skew,
    FRAMES_DROPPED: _frames_dropped,
    GPU_LOST: lambda now, _: {"": condition_from_text(now.gpu_trouble)},
    DISK_FULL: lambda now, _: {"": condition_from_text(now.history_trouble)},
    HISTORY_REPAIRED: lambda now, _: {"": condition_from_text(now.history_repair)},
    USERS_UNREADABLE: lambda now, _: {"": condition_from_text(now.users_trouble)},
    REPORTS_FAILING: lambda now, _: {"": condition_from_text(now.reports_trouble)},
    RECORDING_PAUSED: lambda now, _: {"": condition_from_text(now.recording_trouble)},
    ENCODER_SILENT: _encoder_silent,
    ENCODER_WRONG: lambda now, _: {"": condition_from_text(now.encoder_trouble)},
    CERTIFICATE_EXPIRING: _certificate_expiring,
    MATERIAL_TEST_DUE: _material_test_due,
    TEST_CERTIFICATE_VOID: _test_certificate_void,
}
RULES: Mapping[str, Rule] = {kind: _RULES[kind] for kind in KINDS}
"""The rule of every alarm, in the order of display; each name is that of its settings."""
