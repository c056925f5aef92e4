"""The site's web application: its page, its interface, and the sign-in of any page of Beltscape."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from threading import Lock
from typing import Annotated, Any

from fastapi import Depends, FastAPI, Query
from fastapi.responses import FileResponse

from beltscape import __version__
from beltscape.service.access import Access, User, install_access, require_role
from beltscape.service.static import RevalidatedFiles, make_static_files
from beltscape.site.balancing import BalanceStatus
from beltscape.site.follower import BeltFollower
from beltscape.site.periods import Kind
from beltscape.site.settings import SiteSettings
from beltscape.site.store import SiteStore
from beltscape.site.views import SiteAlarm, list_alarms, show_balance, show_belt, show_totals

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
    app = FastAPI(
        title="Beltscape site",
        version=__version__,
        summary="Several belts of a site: flow, alarms, balances over transfer points, totals.",
        openapi_url="/api/openapi.json",
        docs_url=None,  # its page would load scripts from other servers
        redoc_url=None,
        redirect_slashes=False,  # its address would lack a proxy's path
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
