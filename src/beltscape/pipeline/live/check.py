"""The check of a project before a run: each part that a run opens is opened once and described in one line."""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from beltscape.core.errors import InputError, OutputError
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.core.system_calls import lock_file
from beltscape.pipeline.live.assembly import check_encoder, open_source
from beltscape.pipeline.live.measuring_parts import build_context, read_run_rig
from beltscape.pipeline.live.project import Project, RunSettings, describe_alarms, read_density
from beltscape.sinks.historian.database import open_reader, require_known
from beltscape.sinks.historian.recovery import DATABASE
from beltscape.sinks.settings import RecordingSettings
from beltscape.sources.genicam.aravis import load_aravis

Check = tuple[str, Callable[[], str]]
"""Name of the part, and the function that checks it: it returns a line, or raises a BeltscapeError."""


def list_checks(project: Project[RunSettings], reporter: Reporter) -> Iterator[Check]:
    """Yield the checks of all parts except the page, in the order in which a run opens them."""
    settings = project.settings
    yield "rig", lambda: _describe_rig(read_run_rig(project, reporter))
    yield "alarms", lambda: describe_alarms(project, read_run_rig(project, reporter).cameras)
    yield "density", lambda: _describe_density(project)
    yield "empty", lambda: _describe_empty_belt(project, reporter)
    yield "source", lambda: _describe_source(project, reporter)
    yield "encoder", lambda: _describe_encoder(project)
    yield "data", lambda: check_data(project.resolve(settings.data), settings.recording)


def is_running(data: Path) -> bool:
    """Return whether a run has the history in ``data`` open now."""
    lock = data / "history.lock"
    if not lock.is_file():
        return False
    with lock.open("rb") as guard:
        try:
            lock_file(guard.fileno())
        except OSError:
            return True
    return False


def check_data(data: Path, recording: RecordingSettings) -> str:
    """Return a line about the folder of history and recordings; OutputError or InputError if it cannot be used."""
    existing = next(path for path in (data, *data.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise OutputError(f"{data}: cannot be a folder ({existing} is a file); choose another data folder")
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise OutputError(
            f"{data}: cannot be written ({error.strerror or error}); change its permissions, or choose another "
            "data folder"
        ) from error
    if (data / DATABASE).exists():
        _check_database(data / DATABASE)
    mode = "" if recording.mode == "off" else f", recording {recording.mode}"
    return f"{data} can be written{mode}" + ("; a run uses it now" if is_running(data) else "")


def _check_database(path: Path) -> None:
    if not path.is_file():
        raise InputError(f"{path}: is no file; choose another data folder")
    connection = open_reader(path)
    try:
        require_known(connection, path)
    except sqlite3.Error:
        return  # a run replaces a damaged history, keeps its totals and records an event
    finally:
        connection.close()


def _describe_rig(rig: Rig) -> str:
    width, height = rig.core_camera.size_px
    return f"{len(rig.cameras)} cameras about {rig.core}, {width}×{height} px"


def _describe_density(project: Project[RunSettings]) -> str:
    density = read_density(project)
    given, products = project.settings.density, project.settings.products
    if products:
        return f"{len(products)} products: {', '.join(product.name for product in products)}"
    if given.kg_m3 is not None:
        return f"{given.kg_m3:g} kg/m³"
    return (
        f"{len(density.time_ns)} values"
        if given.table or given.products
        else "not given: volumes without masses"
    )


def _describe_empty_belt(project: Project[RunSettings], reporter: Reporter) -> str:
    belt = build_context(project, read_run_rig(project, reporter), reporter).empty_belt.belt
    x0, x1 = belt.across_mm
    return f"x {x0:.0f} to {x1:.0f} mm, {belt.frames} frames"


def _describe_source(project: Project[RunSettings], reporter: Reporter) -> str:
    settings, rig = project.settings, read_run_rig(project, reporter)
    if settings.cameras is not None:
        missing = [name for name in rig.cameras if name not in settings.cameras.devices]
        if missing:
            raise InputError(
                f"{project.path}: cameras.devices: the rig's camera {missing[0]} has no device; "
                f"there are {', '.join(settings.cameras.devices)}"
            )
        if not is_running(project.resolve(settings.data)):
            load_aravis()
        return f"{len(settings.cameras.devices)} cameras"
    source = open_source(project, rig, reporter, paced=False)
    return f"capture of {', '.join(source.cameras)}"


def _describe_encoder(project: Project[RunSettings]) -> str:
    settings = project.settings
    encoder, capture = settings.encoder, settings.capture
    if encoder.kind == "udp" and is_running(project.resolve(settings.data)):
        return "udp, its port not tried while a run uses it"
    folder = None if capture is None else project.resolve(capture.folder)
    if encoder.kind == "capture" and folder is not None and not encoder.path:
        table = folder / "encoder.csv"
        if not table.is_file():
            raise InputError(
                f'{table}: no such file; encoder kind = "capture" reads it, or choose another kind'
            )
        return f"{table}"
    check_encoder(project)
    return encoder.kind
