"""Start and end of what production does beside the measurement: the belt scale and the reports."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from beltscape.pipeline.live.operation.production import ProductionControl
from beltscape.pipeline.live.project import Project
from beltscape.production.settings import ScaleSettings
from beltscape.service.production.figures import ProductionFigures
from beltscape.service.production.reports import ReportWriter
from beltscape.service.production.scale_counter import ModbusCounter, ScaleCounter, TableCounter
from beltscape.service.production.scale_watch import ScaleWatch
from beltscape.service.project import ProjectSettings
from beltscape.sinks.historian import Historian


@dataclass(frozen=True, slots=True, eq=False)
class ServedProduction:
    """The production of a running system, as page and protocols use it."""

    control: ProductionControl
    figures: ProductionFigures
    reports: ReportWriter | None
    """None: no reports are written."""


@contextmanager
def serve_production(
    control: ProductionControl,
    historian: Historian,
    project: Project[ProjectSettings],
    data: Path,
    on_message: Callable[[str], None],
) -> Generator[ServedProduction]:
    """Read the scale and write the reports until the end of the context.

    Raises
    ------
    InputError
        If a library or a file of the settings is missing.
    """
    scale, reports = project.settings.scale, project.settings.reports
    plant = project.settings.web.plant or project.settings.name
    figures = ProductionFigures(control, scale)
    with ExitStack() as running:
        if scale is not None:
            counter = _open_counter(scale, control)
            watch = ScaleWatch(figures, historian, counter, scale.every_s, on_message)
            watch.start()
            running.callback(watch.close)
        writer = None
        if reports is not None:
            writer = ReportWriter(reports, figures, historian, data, plant, on_message)
            writer.start()
            running.callback(writer.close)
        yield ServedProduction(control, figures, writer)


def _open_counter(scale: ScaleSettings, control: ProductionControl) -> ScaleCounter | None:
    """Return the source of the counter; None where a person types it."""
    if scale.modbus is not None:
        return ModbusCounter(scale.modbus)
    if scale.csv is None:
        return None
    last = control.history.last_reading
    return TableCounter(scale.csv, 0 if last is None else last.wall_ns)
