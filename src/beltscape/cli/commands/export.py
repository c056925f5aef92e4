"""``beltscape export rig.json --format … --out PATH`` or ``export FRAME --out cloud.laz``: other formats."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import CLOUD_FORMATS, add_output_folder
from beltscape.core.progress import Reporter
from beltscape.files.exchange import FORMATS

_FOLDERS = ", ".join(name for name, one in FORMATS.items() if one.is_folder)
_ENDINGS = ", ".join(f".{name}" for name in ("ply", *CLOUD_FORMATS))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "source", type=Path, help="rig.json, or a frame folder of reconstruct, whose cloud is exported"
    )
    parser.add_argument("--format", choices=list(FORMATS), help="rig: format to write")
    parser.add_argument(
        "--belt", type=Path, help="cloud: belt.json, in whose frame it is written (default: the core's)"
    )
    add_output_folder(
        parser,
        f"file to write, for {_FOLDERS} a folder; the ending of a cloud's chooses {_ENDINGS}",
        required=True,
    )
    parser.set_defaults(output=_output_kind, example=_example)


def _example(arguments: argparse.Namespace) -> str:
    return FORMATS[arguments.format].example if arguments.format else "cloud.laz"


def _output_kind(arguments: argparse.Namespace) -> str:
    return "folder" if arguments.format and FORMATS[arguments.format].is_folder else "file"


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Export the rig, or a frame's cloud."""
    if arguments.source.is_dir():
        return _export_cloud(arguments)
    return _export_rig(arguments, reporter)


def _export_rig(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    from beltscape.core.errors import SettingsError
    from beltscape.files.exchange import export_rig
    from beltscape.files.rig_json import read_rig

    if arguments.belt is not None:
        raise SettingsError("--belt places a cloud; leave it out to export a rig")
    rig = read_rig(arguments.source)
    if arguments.format is None:
        raise SettingsError(f"--format is missing: a rig is written as {', '.join(FORMATS)}")
    files = export_rig(arguments.out, rig, arguments.format, reporter)
    return {"format": arguments.format, "core": rig.core, "cameras": list(rig.cameras), "files": files}


def _export_cloud(arguments: argparse.Namespace) -> Mapping[str, Any]:
    from beltscape.core.errors import SettingsError
    from beltscape.pipeline.reconstructing.cloud_export import export_cloud

    if arguments.format is not None:
        raise SettingsError(
            f"--format {arguments.format}: is a rig's; leave it out: the ending of --out chooses a cloud's"
        )
    cloud = export_cloud(arguments.source, arguments.out, arguments.belt)
    return {"cloud": cloud.path, "points": cloud.points, "frame": cloud.frame, "unit": cloud.unit}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    if "cloud" in result:
        return f"{result['cloud']}: {result['points']} points in {result['unit']}, {result['frame']} frame"
    head = f"{result['format']}: {len(result['cameras'])} cameras about {result['core']}"
    return "\n".join([head, *(f"  {file}" for file in result["files"])])
