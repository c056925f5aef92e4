"""View models of the site's page: belts, balances, alarms and totals as JSON values; None: not known."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from beltscape.core.live.alarms import Severity
from beltscape.site.balance import BalanceResult
from beltscape.site.balancing import BalanceStatus
from beltscape.site.follower import BeltView
from beltscape.site.following.catch_up import Sums
from beltscape.site.following.faults import ALARMS, Fault
from beltscape.site.periods import Kind, list_periods
from beltscape.site.settings import SiteSettings
from beltscape.site.store import SiteStore

_WINDOWS = 24
"""Windows of a balance that the page draws."""
_LATE_S = 20.0
"""A ledger that is known up to less than this before now is complete so far; a stopped belt's settles within it."""
_ON = ("raised", "acknowledged", "gone")


def show_belt(view: BeltView) -> dict[str, Any]:
    """Return a belt; what is measured now is None where the belt is away."""
    state, page = view.state, view.page
    shown: dict[str, Any] = {
        "name": view.settings.name,
        "url": view.settings.url,
        "is_away": view.is_away,
        "age_s": view.age_s,
        "faults": [show_fault(fault) for fault in view.faults],
        "version": None if page is None else page.version,
        "plant": "" if page is None else page.plant,
        "full_m3_h": None if page is None else page.full_m3_h,
        "waiting": view.waiting,
        "last_ms": None if state is None else state.wall_ms,
        "totals": None if state is None else state.totals.model_dump(),
        "flow": None,
        "speed_m_s": None,
        "alarms": [],
        "cameras": None,
        "maintenance": None,
    }
    if state is None or view.is_away:
        return shown
    ok = sum(camera.state == "ok" for camera in state.cameras)
    return shown | {
        "flow": state.flow.model_dump(),
        "speed_m_s": state.frames.speed_m_s,
        "alarms": [alarm.model_dump() for alarm in state.alarms if alarm.state in _ON],
        "cameras": {"ok": ok, "all": len(state.cameras)},
        "maintenance": None if state.maintenance is None else state.maintenance.reason,
    }


def show_fault(fault: Fault) -> dict[str, Any]:
    """Return a fault with its text in English."""
    return {"key": fault.key, "values": dict(fault.values), "text": fault.text}


def show_balance(status: BalanceStatus, store: SiteStore) -> dict[str, Any]:
    """Return a transfer point with its newest windows."""
    settings = status.settings
    return {
        "name": settings.name,
        "inflow": settings.inflow,
        "outflow": settings.outflow,
        "unit": "t" if settings.quantity == "mass" else "m3",
        "window_min": settings.window_min,
        "sigmas": settings.sigmas,
        "waits_for": status.waits_for,
        "last": None if status.last is None else show_window(status.last),
        "windows": [show_window(result) for result in store.read_balances(settings.name, _WINDOWS)],
    }


def show_window(result: BalanceResult) -> dict[str, Any]:
    """Return the balance of a window."""
    inflow, outflow = result.inflow, result.outflow
    difference = None if inflow is None or outflow is None else inflow - outflow
    return {**asdict(result), "difference": difference}


@dataclass(frozen=True, slots=True)
class SiteAlarm:
    """An alarm of the site itself that is on."""

    kind: str
    """"away", "imbalance" or the key of a fault."""
    subject: str
    """The belt or the balance."""
    severity: Severity


def list_alarms(belts: Iterable[BeltView], balances: Iterable[BalanceStatus]) -> list[SiteAlarm]:
    """Return the site's own alarms that are on."""
    alarms: list[SiteAlarm] = []
    for view in belts:
        kinds = ["away"] if view.is_away else [fault.key for fault in view.faults if fault.key in ALARMS]
        alarms += [SiteAlarm(kind, view.settings.name, "warning") for kind in kinds]
    for status in balances:
        if status.last is not None and status.last.state == "imbalance":
            alarms.append(SiteAlarm("imbalance", status.settings.name, "critical"))
    return alarms


def show_totals(settings: SiteSettings, store: SiteStore, kind: Kind, count: int) -> dict[str, Any]:
    """Return the totals of the last periods by belts, and of the site."""
    now_s = time.time()
    periods = list_periods(settings, kind, now_s, count)
    rows = [_show_period(settings, store, period, now_s) for period in periods]
    return {
        "belts": [{"name": belt.name, "in_total": settings.is_in_total(belt)} for belt in settings.belts],
        "periods": rows[::-1],
    }


def _show_period(
    settings: SiteSettings, store: SiteStore, period: tuple[int, int, str], now_s: float
) -> dict[str, Any]:
    start_s, end_s, name = period
    belts: dict[str, Any] = {}
    for belt in settings.belts:
        quarters = store.read_quarters(belt.name, start_s, end_s)
        first_s, known_ms = store.read_first_quarter(belt.name), store.read_complete_ms(belt.name)
        is_known = (
            first_s is not None and start_s >= first_s and known_ms >= min(end_s, now_s - _LATE_S) * 1000
        )
        belts[belt.name] = _show_sums(quarters.values()) | {"is_complete": is_known}
    counted = [belts[belt.name] for belt in settings.belts if settings.is_in_total(belt)]
    return {
        "start_ms": start_s * 1000,
        "end_ms": end_s * 1000,
        "name": name,
        "is_running": end_s > now_s,
        "belts": belts,
        "site": _show_site(counted),
    }


def _show_sums(parts: Iterable[Sums]) -> dict[str, Any]:
    total = Sums()
    for sums in parts:
        total += sums
    return {
        "records": total.records,
        "volume_m3": total.volume_m3,
        "sigma_m3": total.sigma_m3,
        "mass_t": None if total.unweighed_m3 else total.mass_t,
        "missing_m": total.missing_m,
        "length_m": total.length_m,
    }


def _show_site(belts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the sums of the belts that count; σ in squares, as the machines' errors are independent."""
    masses = [belt["mass_t"] for belt in belts]
    return {
        "records": sum(belt["records"] for belt in belts),
        "volume_m3": sum(belt["volume_m3"] for belt in belts),
        "sigma_m3": math.hypot(*(belt["sigma_m3"] for belt in belts)),
        "mass_t": None if None in masses else sum(masses),
        "is_complete": all(belt["is_complete"] for belt in belts),
    }
