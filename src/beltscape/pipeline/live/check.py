"""What a run would open, opened once beforehand: each part of a project with one line, or with what is wrong."""

from __future__ import annotations

import fcntl
import sqlite3
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from beltscape.core.errors import InputError, OutputError
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.live.assembly import bench_of, check_encoder, open_source
from beltscape.pipeline.live.project import Project, RunSettings, density_of
from beltscape.pipeline.measuring.flow import fitted
from beltscape.sinks.historian.storage.schema import open_reader, require_known
from beltscape.sinks.historian.writing.recovery import DATABASE
from beltscape.sinks.settings import RecordingSettings

Check = tuple[str, Callable[[], str]]
"""What is checked, and what does so: it returns a line, or raises a BeltscapeError."""


def checks_of(project: Project[RunSettings], reporter: Reporter) -> Iterator[Check]:
    """Yield everything that a run opens but its page, in the order in which it does."""
    settings = project.settings
    yield "rig", lambda: _rig_line(_rig(project, reporter))
    yield "density", lambda: _density_line(project)
    yield "empty", lambda: _empty_line(project, reporter)
    yield "source", lambda: _source_line(project, reporter)
    yield "encoder", lambda: _encoder_line(project)
    yield "data", lambda: check_data(project.place(settings.data), settings.recording)


def is_running(data: Path) -> bool:
    """Whether a run has the history in ``data`` open now."""
    lock = data / "history.lock"
    if not lock.is_file():
        return False
    with lock.open("rb") as guard:
        try:
            fcntl.flock(guard, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
    return False


def check_data(data: Path, recording: RecordingSettings) -> str:
    """Return a line about the folder of history and recordings; OutputError or InputError where it cannot be used."""
    there = next(path for path in (data, *data.absolute().parents) if path.exists())
    if not there.is_dir():
        raise OutputError(f"{data}: cannot be a folder ({there} is a file); choose another data folder")
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise OutputError(
            f"{data}: cannot be written ({error.strerror or error}); mend its rights, or choose another data folder"
        ) from error
    if (data / DATABASE).exists():
        _check_database(data / DATABASE)
    kept = "" if recording.mode == "off" else f", recording {recording.mode}"
    return f"{data} can be written{kept}" + ("; a run uses it now" if is_running(data) else "")


def _check_database(path: Path) -> None:
    if not path.is_file():
        raise InputError(f"{path}: is no file; choose another data folder")
    connection = open_reader(path)
    try:
        require_known(connection, path)
    except sqlite3.Error:
        return  # a damaged history is begun anew, with its totals, and an event says so
    finally:
        connection.close()


def _rig(project: Project[RunSettings], reporter: Reporter) -> Rig:
    rig = read_rig(project.place(project.settings.rig))
    capture = project.settings.capture
    return rig if capture is None else fitted(rig, project.place(capture.folder), reporter)


def _rig_line(rig: Rig) -> str:
    width, height = rig.core_camera.size_px
    return f"{len(rig.cameras)} cameras about {rig.core}, {width}×{height} px"


def _density_line(project: Project[RunSettings]) -> str:
    density = density_of(project)
    told = project.settings.density
    if told.kg_m3 is not None:
        return f"{told.kg_m3:g} kg/m³"
    return (
        f"{len(density.time_ns)} values"
        if told.table or told.products
        else "not told: volumes without masses"
    )


def _empty_line(project: Project[RunSettings], reporter: Reporter) -> str:
    belt = bench_of(project, _rig(project, reporter), reporter).ground.belt
    x0, x1 = belt.across_mm
    return f"x {x0:.0f} to {x1:.0f} mm, {belt.frames} frames"


def _source_line(project: Project[RunSettings], reporter: Reporter) -> str:
    settings, rig = project.settings, _rig(project, reporter)
    if settings.cameras is not None:
        missing = [name for name in rig.cameras if name not in settings.cameras.devices]
        if missing:
            raise InputError(
                f"{project.path}: cameras.devices: the rig's camera {missing[0]} has no device; "
                f"there are {', '.join(settings.cameras.devices)}"
            )
        return f"{len(settings.cameras.devices)} cameras, not opened: see beltscape cameras --check {project.path}"
    source = open_source(project, rig, reporter, paced=False)
    return f"capture of {', '.join(source.cameras)}"


def _encoder_line(project: Project[RunSettings]) -> str:
    settings = project.settings
    encoder, capture = settings.encoder, settings.capture
    if encoder.kind == "udp" and is_running(project.place(settings.data)):
        return "udp, its port not tried while a run uses it"
    folder = None if capture is None else project.place(capture.folder)
    if encoder.kind == "capture" and folder is not None and not encoder.path:
        table = folder / "encoder.csv"
        if not table.is_file():
            raise InputError(
                f'{table}: no such file; encoder kind = "capture" reads it, or choose another kind'
            )
        return f"{table}"
    check_encoder(project)
    return encoder.kind
