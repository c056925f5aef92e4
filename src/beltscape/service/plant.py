"""The run of a project: engine, history, operator's page and access of one project.toml."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from threading import Event
from time import time
from typing import Any

from beltscape.core.belt.ledger_entries import Totals
from beltscape.core.live import Observers
from beltscape.files.systemd import notify
from beltscape.pipeline.live.assembly import AssembledRun, RunOptions, assemble
from beltscape.pipeline.live.project import Project
from beltscape.service.access import Access
from beltscape.service.access.tls import read_expiry
from beltscape.service.app import create_app
from beltscape.service.lifecycle import log_address
from beltscape.service.live_state import LiveState
from beltscape.service.log import LogObserver
from beltscape.service.production.serving import ServedProduction, serve_production
from beltscape.service.project import ProjectSettings
from beltscape.service.protocol_users import ServedUsers, describe_provenance
from beltscape.service.protocols import ProtocolSettings, ServedPlant, serve_protocols
from beltscape.service.server import RunningServer, check_listening, serve

_DAY_S = 86_400.0
"""Seconds of a day."""
_POLL_S = 0.1
"""Interval at which the stop event is checked."""


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
    if page:
        check_listening(project.settings.web)  # before the history is opened
    live_state = LiveState(project.settings.web)
    has_users = page or project.settings.opcua is not None
    access = Access(options.data, project.settings.web.access) if has_users else None
    if access is not None:
        options = replace(options, users_trouble=lambda: access.trouble)
    assembled = assemble(project, options, Observers([live_state, LogObserver()]))
    totals_before = assembled.historian.totals
    users = None if access is None else ServedUsers(access)
    provenance = describe_provenance(project)
    with (
        nullcontext() if access is None else closing(access),
        serve_production(
            assembled.production, assembled.historian, project, options.data, live_state.on_message
        ) as made,
        serve_protocols(
            ProtocolSettings(project.settings.mqtt, project.settings.modbus, project.settings.opcua),
            ServedPlant(
                live_state,
                assembled.historian,
                assembled.engine.acknowledge,
                users,
                provenance,
                assembled.production,
            ),
            options.data,
            live_state.on_message,
        ),
        _serve_page(project, access, live_state, assembled, made)
        if access and page
        else nullcontext() as running,
    ):
        assembled.engine.start()
        notify("READY=1")
        log_address(running)
        try:
            while not stop.is_set() and not assembled.engine.wait(_POLL_S):
                pass
        finally:
            notify("STOPPING=1")
            unwritten = assembled.engine.stop()
    summary = _make_summary(project, options.data, totals_before, assembled.historian.totals, unwritten)
    assembled.close()
    return summary


@contextmanager
def _serve_page(
    project: Project[ProjectSettings],
    access: Access,
    live_state: LiveState,
    assembled: AssembledRun,
    production: ServedProduction,
) -> Generator[RunningServer]:
    web = project.settings.web
    app = create_app(live_state, assembled.historian, access, assembled.engine, web, production=production)
    running = serve(app, web)
    try:
        yield running
    finally:
        running.close()


def make_expiry_counter(certificate: Path | None, key: Path | None) -> Callable[[], float]:
    """Return a function that gives the days until the certificate expires; NaN without a certificate."""
    if certificate is None or key is None:
        return lambda: float("nan")
    expiry_s = read_expiry(certificate, key)
    return lambda: (expiry_s - time()) / _DAY_S


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
