"""The viewer's contents in Rerun (rerun.io), an optional viewer with a time line."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from beltscape.core.errors import OutputError, SettingsError
from beltscape.report.viewer import ViewerScene


def import_rerun() -> Any:
    """Import and return the module ``rerun``.

    Raises
    ------
    SettingsError
        When it is not installed.
    """
    try:
        return import_module("rerun")
    except ImportError as error:
        raise SettingsError("--rerun: rerun-sdk is not installed; pip install 'beltscape[viewer]'") from error


def show_in_rerun(rerun: Any, view: ViewerScene, out: Path | None) -> None:
    """Log the contents into an .rrd file, or into the Rerun viewer, which is started, if ``out`` is None.

    Raises
    ------
    OutputError
        When the file cannot be written or the viewer not be started.
    """
    try:
        recording = rerun.RecordingStream("beltscape", recording_id=view.title)
        if out is None:
            recording.spawn()
        else:
            recording.save(str(out))
        _log(rerun, recording, view)
        recording.flush()
    except (OSError, RuntimeError) as error:
        raise OutputError(
            f"{out or 'rerun'}: {error}; check that the folder exists and rerun-sdk is installed completely"
        ) from error


def _log(rerun: Any, recording: Any, view: ViewerScene) -> None:
    recording.log("/", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for layer in dict.fromkeys(layer for layer, _, _ in view.lines):
        own = [(color, line) for name, color, line in view.lines if name == layer]
        strips = rerun.LineStrips3D([line for _, line in own], colors=[_rgb(color) for color, _ in own])
        recording.log(f"{layer}/lines", strips, static=True)
    for layer in dict.fromkeys(layer for layer, _, _ in view.labels):
        named = [(text, at) for name, text, at in view.labels if name == layer]
        places = rerun.Points3D([at for _, at in named], labels=[text for text, _ in named], radii=3.0)
        recording.log(f"{layer}/names", places, static=True)
    for layer, color, triangles in view.surfaces:
        mesh = rerun.Mesh3D(vertex_positions=triangles.reshape(-1, 3), albedo_factor=[*_rgb(color), 110])
        recording.log(layer, mesh, static=True)
    for number, cloud in enumerate(view.clouds):
        recording.set_time("frame", sequence=number)
        recording.log("cloud", rerun.Points3D(cloud.points_mm, colors=cloud.colors))
        recording.log("frame", rerun.TextLog(cloud.name))


def _rgb(color: str) -> list[int]:
    return [int(color[i : i + 2], 16) for i in (1, 3, 5)]
