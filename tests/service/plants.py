"""A complete service with a simulated plant and a history of some seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from fastapi import FastAPI

from beltscape.core.errors import InputError
from beltscape.core.ledger import BeltRecord, Totals
from beltscape.pipeline.live.ledger import add_tag
from beltscape.pipeline.live.production import ProductionControl
from beltscape.service.access import Access, AccessSettings
from beltscape.service.access.accounts import Role
from beltscape.service.app import create_app
from beltscape.service.changes import Changed
from beltscape.service.live_state import LiveState
from beltscape.service.production.figures import ProductionFigures
from beltscape.service.production.reports import ReportWriter
from beltscape.service.production.serving import ReportStatus, ServedProduction
from beltscape.service.reloader import Reload
from beltscape.service.settings import WebSettings
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.service.access.sample_app import CHEAP, PASSWORD, Browser
from tests.service.feeder import SimulatedPlant

BEGIN_NS = 1_790_000_000_000_000_000
STEP_NS = 200_000_000


@dataclass
class ServiceParts:
    """The parts of a service under test."""

    live_state: LiveState
    history: Historian
    access: Access
    plant: SimulatedPlant
    settings: WebSettings
    folder: Path
    reloader: FakeReloader
    app: FastAPI

    def browser(self, role: Role | Literal[""] = "") -> Browser:
        """Return a browser signed in with that role; "": not signed in."""
        browser = Browser(self.app, "127.0.0.1")
        if role:
            self.access.accounts.add(f"the-{role}", role, PASSWORD)
            assert browser.log_in(f"the-{role}").status_code == 200
        return browser


class FakeReloader:
    """A project whose density and address have changed; ``fault`` refuses it."""

    def __init__(self) -> None:
        self.by: list[str] = []
        self.fault = ""

    def find_changes(self) -> Reload:
        if self.fault:
            raise InputError(self.fault)
        density = () if self.by else (Changed("density.kg_m3", "1500.0", "1600.0"),)
        return Reload(density, (Changed("web.port", "8460", "8461"),))

    def reload(self, by: str, address: str = "") -> Reload:
        done = self.find_changes()
        self.by.append(f"{by} {address}")
        return done


class TaggingLedger:
    """A history whose records are counted for the present product and batch."""

    def __init__(self, history: Historian, control: ProductionControl) -> None:
        self._history, self._control = history, control

    @property
    def totals(self) -> Totals:
        return self._history.totals

    def write(self, records: Sequence[BeltRecord]) -> None:
        self._history.write([add_tag(record, self._control.tag) for record in records])


def add_production(
    parts: ServiceParts, figures: ProductionFigures, reports: ReportWriter | None = None
) -> ServiceParts:
    """Return the service with products and batches, for which its records are counted."""
    parts.plant.ledger = TaggingLedger(parts.history, figures.control)
    served = ServedProduction(figures.control, parts.history, parts.folder, print, ReportStatus())
    served.figures, served.reports = figures, reports
    parts.app = create_app(
        parts.live_state, parts.history, parts.access, parts.plant, parts.settings, production=served,
        reloader=parts.reloader,
    )  # fmt: skip
    return parts


def make_service(folder: Path, frames: int = 0, **settings: Any) -> ServiceParts:
    """Return a service whose plant has measured ``frames`` frames."""
    defaults: dict[str, Any] = {"port": 0, "plant": "Belt 7", "page_rate_hz": 10.0}
    web = WebSettings(**(defaults | settings))
    live_state, history = LiveState(web), Historian(folder, HistorySettings())
    history.begin_run()
    access = Access(folder, web.access, CHEAP)
    plant = SimulatedPlant([live_state], history)
    for k in range(frames):
        plant.step(BEGIN_NS + k * STEP_NS)
    reloader = FakeReloader()
    app = create_app(live_state, history, access, plant, web, reloader=reloader)
    return ServiceParts(live_state, history, access, plant, web, folder, reloader, app)


OPEN = AccessSettings(anonymous_role="viewer")
