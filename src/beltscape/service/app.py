"""The web application: the operator's page and its HTTP interface."""

from __future__ import annotations

from fastapi import FastAPI
from fastapi.responses import FileResponse

from beltscape.core.interfaces import Controls
from beltscape.service.access import Access, install_access
from beltscape.service.api import alarms, export, health, live_stream, metrics, state
from beltscape.service.api import controls as controls_api
from beltscape.service.api import drift as drift_api
from beltscape.service.api import history as history_api
from beltscape.service.api import production as production_api
from beltscape.service.api import settings as settings_api
from beltscape.service.api.common import AppContext
from beltscape.service.live_state import LiveState
from beltscape.service.production.serving import ServedProduction
from beltscape.service.settings import WebSettings
from beltscape.service.static import FOLDER, make_page_app, make_static_files
from beltscape.sinks.historian import Historian


def create_app(
    live_state: LiveState,
    history: Historian,
    access: Access,
    controls: Controls,
    settings: WebSettings,
    reloader: settings_api.Reloader | None = None,
    production: ServedProduction | None = None,
    drift: drift_api.DriftControl | None = None,
) -> FastAPI:
    """Return the application: page, API (described at /api/openapi.json), WebSocket, metrics and access.

    ``reloader`` reads the settings again for engineers; None: the page's part for it stays away;
    without ``production`` so do products, batches and reports, and without ``drift`` that of the rig.
    """
    app = make_page_app(
        "Beltscape", "Bulk material on a conveyor belt: flow, totals, surface, alarms, history."
    )
    live_state.restore_totals(history.totals)
    live_state.set_settings(settings)
    context = AppContext(live_state, history, controls, production)
    for make_router in (
        state.make_router, state.make_pictures_router, alarms.make_router, controls_api.make_router,
        history_api.make_router, export.make_router, health.make_router, health.make_images_router,
        health.make_zero_router, metrics.make_router, production_api.make_router,
        production_api.make_reports_router,
    ):  # fmt: skip
        app.include_router(make_router(context))
    if reloader is not None:
        app.include_router(settings_api.make_router(reloader))
    if drift is not None:
        app.include_router(drift_api.make_router(drift))
    live_stream.add_live_route(app, context)
    app.mount("/page", make_static_files(), name="page")

    @app.get("/", include_in_schema=False)
    def index() -> FileResponse:
        """The operator's page."""
        return FileResponse(FOLDER / "index.html")

    install_access(app, access, public=("/metrics",) if settings.metrics_open else ())
    return app
