"""The run of a project: engine, history, operator's page and access of one project.toml."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from threading import Event
from typing import Any

from beltscape.core.interfaces import Observers
from beltscape.core.ledger import Totals
from beltscape.core.system_calls import notify
from beltscape.pipeline.certifying.certificates import CertificateWatch
from beltscape.pipeline.live.assembly import RunOptions, assemble
from beltscape.pipeline.live.project import Project
from beltscape.service.access import Access
from beltscape.service.app import create_app
from beltscape.service.check import check_start
from beltscape.service.drift import ServedDrift
from beltscape.service.hosting import RunningServer, log_address, serve
from beltscape.service.live_state import LiveState
from beltscape.service.log import LogObserver
from beltscape.service.production.serving import ReportStatus, ServedProduction, serve_production
from beltscape.service.project import ProjectSettings
from beltscape.service.protocols import (
    STARTERS,
    ProtocolSettings,
    ServedPlant,
    ServedUsers,
    describe_provenance,
    serve_protocols,
)
from beltscape.service.reload_requests import answer_requests, discard_requests
from beltscape.service.reloader import RunningPlant, SettingsReloader
from beltscape.service.tls import CertificateExpiry

_POLL_S = 0.1
"""Interval at which the stop event and requests of the command `reload` are looked for."""


def run_plant(
    project: Project[ProjectSettings],
    options: RunOptions,
    stop: Event,
    *,
    page: bool,
) -> dict[str, Any]:
    """Measure until ``stop`` is set or a recording ends, then shut down and return the summary of the run.

    ``page``: serve the operator's page while it runs.

    Raises
    ------
    InputError, SettingsError, MeasureError, OutputError
        With one line that names the fault and the fix.
    """
    check_start(project, page=page)  # before the history is opened
    plant = _make_plant(project, options, page=page)
    assembled = plant.assembled
    totals_before, reloader = assembled.historian.totals, _make_reloader(plant, options.data)
    protocols = ProtocolSettings(**{name: getattr(project.settings, name) for name in STARTERS})
    with (
        closing(plant.access),
        serve_production(plant.production, project),
        serve_protocols(
            protocols, plant.served, options.data, plant.assembled.components.observer.on_message
        ) as plant.protocols,
        _serve_page(plant, reloader, options.data) if page else nullcontext() as plant.server,
    ):
        assembled.engine.start()
        notify("READY=1")
        log_address(plant.server)
        try:
            while not stop.is_set() and not assembled.engine.wait(_POLL_S):
                answer_requests(options.data, reloader)
        finally:
            notify("STOPPING=1")
            unwritten = assembled.engine.stop()
    summary = _make_summary(project, options.data, totals_before, assembled.historian.totals, unwritten)
    latency = plant.live_state.summarise_latency()
    summary.update((name, asdict(distribution)) for name, distribution in latency.items())
    assembled.close()
    return summary


def _make_plant(project: Project[ProjectSettings], options: RunOptions, *, page: bool) -> RunningPlant:
    """Open everything that the run needs, without starting it."""
    web, live_state = project.settings.web, LiveState(project.settings.web)
    access = Access(options.data, web.access)
    expiry = CertificateExpiry(web.tls_certificate, web.tls_key) if page else CertificateExpiry(None, None)
    reports = ReportStatus()
    options = replace(
        options,
        certificate_days=expiry,
        read_certificate=CertificateWatch(options.data),
        reports_trouble=lambda: reports.trouble,
    )
    if page or project.settings.opcua is not None:
        options = replace(options, users_trouble=lambda: access.trouble)
    assembled = assemble(project, options, Observers([live_state, LogObserver()]))
    served = ServedPlant(
        live_state,
        assembled.historian,
        assembled.engine.acknowledge,
        ServedUsers(access),
        describe_provenance(project),
        assembled.production,
    )
    production = ServedProduction(
        assembled.production,
        assembled.historian,
        options.data,
        assembled.components.observer.on_message,
        reports,
    )
    return RunningPlant(project, assembled, assembled.parts, live_state, access, expiry, served, production)


def _make_reloader(plant: RunningPlant, data: Path) -> SettingsReloader:
    """Return what reads the settings again on request; requests from before this run are forgotten."""
    discard_requests(data)
    components = plant.assembled.components
    return SettingsReloader(plant, components.events, components.reporter)


@contextmanager
def _serve_page(plant: RunningPlant, reloader: SettingsReloader, data: Path) -> Generator[RunningServer]:
    web, assembled = plant.project.settings.web, plant.assembled
    app = create_app(
        plant.live_state,
        assembled.historian,
        plant.access,
        assembled.engine,
        web,
        production=plant.production,
        reloader=reloader,
        drift=ServedDrift(
            plant.project.path, data, plant.access, reloader.reload_rig, assembled.components.reporter
        ),
    )
    running = serve(app, web)
    try:
        yield running
    finally:
        running.close()


def _make_summary(
    project: Project[ProjectSettings], data: Path, before: Totals, after: Totals, unwritten: int
) -> dict[str, Any]:
    """Return what this run counted, and the totals of all runs."""
    return {
        "project": project.path,
        "data": data,
        "records": after.records - before.records,
        "volume_mm3": after.volume_mm3 - before.volume_mm3,
        "mass_kg": after.mass_kg - before.mass_kg,
        "valid_mm": after.valid_mm - before.valid_mm,
        "degraded_mm": after.degraded_mm - before.degraded_mm,
        "missing_mm": after.missing_mm - before.missing_mm,
        "unwritten_records": unwritten,
        "totals": asdict(after),
    }
