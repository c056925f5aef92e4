"""The belt scale and the reports of a running plant, beside the measurement; each can be exchanged while it runs."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from beltscape.pipeline.live.production import ProductionControl
from beltscape.pipeline.live.project import Project
from beltscape.production.settings import ReportSettings, ScaleSettings
from beltscape.service.production.belt_scale import ModbusCounter, ScaleCounter, ScaleWatch, TableCounter
from beltscape.service.production.figures import ProductionFigures
from beltscape.service.production.reports import ReportWriter
from beltscape.service.project import ProjectSettings
from beltscape.sinks.historian import Historian


@dataclass(slots=True)
class ReportStatus:
    """State of the delivery of reports."""

    trouble: str = ""
    """Why they are not written, mailed or printed, in one line; empty: they are, or need not be."""


class ServedProduction:
    """The production of a running system, as page and protocols use it."""

    def __init__(
        self,
        control: ProductionControl,
        historian: Historian,
        data: Path,
        on_message: Callable[[str], None],
        status: ReportStatus,
    ) -> None:
        """Serve without a scale and reports; `exchange_scale` and `exchange_reports` begin them."""
        self.control = control
        self.figures = ProductionFigures(control, None)
        self.reports: ReportWriter | None = None
        """None: no reports are written."""
        self._historian, self._data = historian, data
        self._on_message, self._status = on_message, status
        self._watch: ScaleWatch | None = None

    def exchange_scale(self, scale: ScaleSettings | None) -> None:
        """Read and compare another scale from now on; None: none. InputError if a library is missing."""
        counter = None if scale is None else _open_counter(scale, self.control)
        if self._watch is not None:
            self._watch.close()
        self._watch, self.figures.scale = None, scale
        if scale is not None:
            self._watch = ScaleWatch(self.figures, self._historian, counter, scale.every_s, self._on_message)
            self._watch.start()

    def exchange_reports(self, settings: ReportSettings | None, plant: str) -> None:
        """Write reports by other settings from now on; None: none. What waits for its delivery goes on waiting.

        Raises
        ------
        InputError, OutputError
            If a library or a file of the settings is missing, or the folder cannot be made.
        """
        if self.reports is not None:
            self.reports.close()
        self.reports, self._status.trouble = None, ""
        if settings is None:
            return
        writer = ReportWriter(
            settings, self.figures, self._historian, self._data, plant, self._on_message, self._set_trouble
        )
        writer.start()
        self.reports = writer

    def close(self) -> None:
        """End both."""
        self.exchange_scale(None)
        self.exchange_reports(None, "")

    def _set_trouble(self, trouble: str) -> None:
        self._status.trouble = trouble


@contextmanager
def serve_production(
    production: ServedProduction, project: Project[ProjectSettings]
) -> Generator[ServedProduction]:
    """Read the scale and write the reports until the end of the context.

    Raises
    ------
    InputError
        If a library or a file of the settings is missing.
    """
    try:
        production.exchange_scale(project.settings.scale)
        production.exchange_reports(project.settings.reports, name_plant(project.settings))
        yield production
    finally:
        production.close()


def name_plant(settings: ProjectSettings) -> str:
    """Return the name of the plant in reports."""
    return settings.web.plant or settings.name


def _open_counter(scale: ScaleSettings, control: ProductionControl) -> ScaleCounter | None:
    """Return the source of the counter; None where a person types it."""
    if scale.modbus is not None:
        return ModbusCounter(scale.modbus)
    if scale.csv is None:
        return None
    last = control.history.last_reading
    return TableCounter(scale.csv, 0 if last is None else last.wall_ns)
