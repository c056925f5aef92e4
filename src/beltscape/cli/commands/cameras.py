"""``beltscape cameras [--check PROJECT]``: lists the cameras on the network, and checks settings against them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "--check",
        type=Path,
        metavar="PROJECT",
        help="project.toml: open its cameras once with its [cameras] settings",
    )


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Find the cameras; with ``--check`` open those of the project."""
    from dataclasses import asdict

    from beltscape.pipeline.recording.project import read_recording_project
    from beltscape.sources.genicam import device
    from beltscape.sources.genicam.aravis import find_cameras

    settings = None if arguments.check is None else read_recording_project(arguments.check).cameras
    cameras = [{**asdict(one), **asdict(device.inspect_camera(one.device))} for one in find_cameras()]
    for one in cameras:
        if one["trouble"]:
            reporter.warn(f"{one['device']} ({one['address']}): {one['trouble']}")
    checked = (
        {} if settings is None else {name: device.check_settings(name, settings) for name in settings.devices}
    )
    return {
        "cameras": cameras,
        "check": {name: one.trouble for name, one in checked.items()},
        "applied": {
            name: {"exposure_us": one.exposure_us, "gain_db": one.gain_db}
            for name, one in checked.items()
            if not one.trouble
        },
    }


def summary(result: Mapping[str, Any]) -> str:
    """Return one or two lines for each camera."""
    lines: list[str] = []
    for one in result["cameras"]:
        width, height = one["size_px"]
        lines.append(
            f"{one['device']:<28} {one['address']:<15} {one['maker']} {one['model']}, serial {one['serial']}"
        )
        if not one["trouble"]:
            lines.append(f"{'':<28} {width}×{height} px, {', '.join(one['formats'])}")
    if not lines:
        lines.append(
            "no camera answers; check power and cables, and that the network card has an address in the same network"
        )
    lines += [
        f"{name:<28} {trouble or _describe_applied(result['applied'][name])}"
        for name, trouble in result["check"].items()
    ]
    return "\n".join(lines)


def _describe_applied(applied: Mapping[str, float | None]) -> str:
    """Return that a camera accepts its settings, with what it says of exposure time and gain."""
    exposure, gain = applied["exposure_us"], applied["gain_db"]
    found = [] if exposure is None else [f"exposure {exposure:g} µs"]
    found += [] if gain is None else [f"gain {gain:g} dB"]
    return ", ".join(["fits", *found])
