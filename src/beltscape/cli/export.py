"""``beltscape export rig.json --format opencv|kalibr|colmap|ros --out PATH``: writes another program's format."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_folder
from beltscape.core.progress import Reporter
from beltscape.files.exchange import FORMATS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("rig", type=Path, help="rig.json to export")
    parser.add_argument("--format", choices=list(FORMATS), required=True, help="format to write")
    add_output_folder(parser, "file to write; for ros a folder", required=True)
    parser.set_defaults(output=_output_kind, example=_example)


def _example(arguments: argparse.Namespace) -> str:
    return EXAMPLES[arguments.format]


EXAMPLES = {
    "opencv": "rig.yaml",
    "kalibr": "camchain.yaml",
    "colmap": "rig_config.json",
    "ros": "camera_info",
}
"""Format → an example of ``--out``."""


def _output_kind(arguments: argparse.Namespace) -> str:
    return "folder" if arguments.format == "ros" else "file"


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Export the rig."""
    from beltscape.files.exchange import export_rig
    from beltscape.files.rig_json import read_rig

    rig = read_rig(arguments.rig)
    files = export_rig(arguments.out, rig, arguments.format, reporter)
    return {"format": arguments.format, "core": rig.core, "cameras": list(rig.cameras), "files": files}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    head = f"{result['format']}: {len(result['cameras'])} cameras about {result['core']}"
    return "\n".join([head, *(f"  {file}" for file in result["files"])])
