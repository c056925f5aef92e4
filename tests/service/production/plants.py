"""A history with some shifts of production, for reports and the interface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import time_ns

from beltscape.pipeline.live.event_log import EventLog
from beltscape.pipeline.live.production import ProductionControl
from beltscape.production.settings import ProductionSettings, ProductSettings, ScaleSettings, ShiftSettings
from beltscape.service.production.figures import ProductionFigures
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import START_NS, ledger

HOUR_NS = 3600 * 10**9
PRODUCTS = (
    ProductSettings(name="ore", density_kg_m3=1600, sigma_kg_m3=40, moisture_percent=4, colour="#8a3b12"),
    ProductSettings(name="coal", density_kg_m3=800, sigma_kg_m3=16),
)
SETTINGS = ProductionSettings(
    time_zone="Europe/Berlin",
    shifts=tuple(
        ShiftSettings(name=name, begins=begins)
        for name, begins in (("early", "06:00"), ("late", "14:00"), ("night", "22:00"))
    ),
)


class Silent:
    """A reporter that keeps its warnings."""

    def __init__(self) -> None:
        self.warnings: list[str] = []

    def warn(self, message: str) -> None:
        self.warnings.append(message)

    def step(self, stage: str, done: int, total: int) -> None:
        """Nothing is shown."""


def make_control(history: Historian, wall_ns: Callable[[], int] = time_ns) -> ProductionControl:
    """Return the control of three products and three shifts."""
    return ProductionControl(PRODUCTS, SETTINGS, history.production, EventLog(history), wall_ns)


def make_production(
    folder: Path, scale: ScaleSettings | None = None, *, records: int = 360
) -> tuple[Historian, ProductionFigures]:
    """Return a history of one record a minute from 16:13 in Berlin on, and its figures."""
    history = Historian(folder, HistorySettings())
    history.begin_run()
    history.production.change_product("ore", "anna", START_NS)
    control = make_control(history, lambda: START_NS)
    history.write([
        replace(record, product="ore")
        for record in ledger(records, every_ns=60 * 10**9, sections=False)
    ])  # fmt: skip
    return history, ProductionFigures(control, scale)
