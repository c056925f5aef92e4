"""The site's web application: its page, its interface, and the sign-in of any page of Beltscape.

The page shows belts, balances, alarms and totals as JSON values; None: not known. Totals are those of hours, shifts
and days in the site's time zone.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Lock
from typing import Annotated, Any, Literal

from fastapi import Depends, FastAPI, Query
from fastapi.responses import FileResponse

from beltscape import __version__
from beltscape.core.alarms import Severity
from beltscape.production.calendar import open_zone
from beltscape.production.shifts import list_production_days, list_shifts
from beltscape.service.access import Access, User, install_access, require_role
from beltscape.service.static import RevalidatedFiles, make_page_app, make_static_files
from beltscape.site.balance import BalanceResult
from beltscape.site.balancing import BalanceStatus
from beltscape.site.catch_up import RecordSums
from beltscape.site.client import FAULT_ALARMS, BeltFault
from beltscape.site.follower import BeltFollower, BeltView
from beltscape.site.settings import SiteSettings
from beltscape.site.store import SiteStore

Kind = Literal["hour", "shift", "day"]
_HOUR_S = 3600
"""Seconds of an hour."""
_DAY_NS = 86_400_000_000_000
"""Nanoseconds of a day."""
_S_NS = 1_000_000_000
"""Nanoseconds of a second."""


def list_periods(settings: SiteSettings, kind: Kind, now_s: float, count: int) -> list[tuple[int, int, str]]:
    """Return begin, end (s since 1970) and name of the last ``count`` periods, oldest first; the last has begun.

    Hours are those of UTC, so that none is lost or doubled when the clocks change; only shifts have a name.
    """
    if kind == "hour":
        hour = int(now_s) // _HOUR_S * _HOUR_S
        starts = range(hour - (count - 1) * _HOUR_S, hour + 1, _HOUR_S)
        return [(start, start + _HOUR_S, "") for start in starts]
    zone, now_ns = open_zone(settings.time_zone), round(now_s * _S_NS)
    per_day = len(settings.shifts) if kind == "shift" else 1
    since_ns = now_ns - (count // max(per_day, 1) + 2) * _DAY_NS
    list_all = list_shifts if kind == "shift" else list_production_days
    periods = [one for one in list_all(settings.shifts, zone, since_ns, now_ns) if one.since_ns <= now_ns]
    return [(one.since_ns // _S_NS, one.until_ns // _S_NS, one.name) for one in periods[-count:]]


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


def show_fault(fault: BeltFault) -> dict[str, Any]:
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
        kinds = (
            ["away"] if view.is_away else [fault.key for fault in view.faults if fault.key in FAULT_ALARMS]
        )
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


def _show_sums(parts: Iterable[RecordSums]) -> dict[str, Any]:
    total = RecordSums()
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


FOLDER = Path(__file__).parent / "page"
Viewer = Annotated[User, Depends(require_role("viewer"))]


class SiteState:
    """The belts, balances and alarms of a site as they are now. Thread-safe."""

    def __init__(self, settings: SiteSettings, followers: Sequence[BeltFollower], store: SiteStore) -> None:
        self.settings, self.store, self._followers = settings, store, followers
        self._lock = Lock()
        self._balances: tuple[BalanceStatus, ...] = ()
        self._since_ms: dict[SiteAlarm, int] = {}

    def update(self, balances: Sequence[BalanceStatus], now_ms: int) -> list[SiteAlarm]:
        """Set the status of the transfer points; return the alarms that are new."""
        views = [follower.take_view() for follower in self._followers]
        alarms = list_alarms(views, balances)
        with self._lock:
            before = self._since_ms
            self._balances = tuple(balances)
            self._since_ms = {alarm: before.get(alarm, now_ms) for alarm in alarms}
        return [alarm for alarm in alarms if alarm not in before]

    def take_snapshot(self) -> dict[str, Any]:
        """Return what the page shows."""
        views = [follower.take_view() for follower in self._followers]
        with self._lock:
            balances, since_ms = self._balances, self._since_ms
        return {
            "wall_ms": round(time.time() * 1000),
            "belts": [show_belt(view) for view in views],
            "balances": [show_balance(status, self.store) for status in balances],
            "alarms": [asdict(alarm) | {"since_ms": raised_ms} for alarm, raised_ms in since_ms.items()],
        }


def create_site_app(state: SiteState, access: Access) -> FastAPI:
    """Return the application; described at /api/openapi.json."""
    settings = state.settings
    app = make_page_app(
        "Beltscape site", "Several belts of a site: flow, alarms, balances over transfer points, totals."
    )
    app.mount("/page", make_static_files(), name="page")
    app.mount("/site", RevalidatedFiles(directory=FOLDER), name="site")

    @app.get("/", include_in_schema=False)
    def index() -> FileResponse:
        """The site's page."""
        return FileResponse(FOLDER / "index.html")

    @app.get("/api/page", tags=["site"])
    def page(user: Viewer) -> dict[str, Any]:
        """The signed-in user and the settings of the page."""
        return {
            "plant": settings.web.plant,
            "language": settings.web.language,
            "time_zone": settings.time_zone,
            "version": __version__,
            "user": user.name,
            "role": user.role,
        }

    @app.get("/api/site", tags=["site"])
    def site(_: Viewer) -> dict[str, Any]:
        """Belts, balances and alarms as they are now."""
        return state.take_snapshot()

    @app.get("/api/site/totals", tags=["site"])
    def totals(
        _: Viewer, kind: Kind = "hour", count: Annotated[int, Query(ge=1, le=200)] = 24
    ) -> dict[str, Any]:
        """Totals of the last hours, shifts or days, newest first."""
        return show_totals(settings, state.store, kind, count)

    install_access(app, access, public=("/site/",))
    return app
