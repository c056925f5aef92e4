"""``beltscape import PATH --out rig.json [--format …] [--core CAM]``: reads a rig of another program."""  # noqa: N999

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_file
from beltscape.core.progress import Reporter
from beltscape.files.exchange import READABLE


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("source", metavar="PATH", type=Path, help="file, or folder of camera files")
    add_output_file(parser, "rig.json to write", "rig.json", required=True)
    parser.add_argument("--format", choices=list(READABLE), help="its format (default: detected)")
    parser.add_argument("--core", metavar="CAM", help="core camera (default: the file's reference)")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Import the rig."""
    from beltscape.core.errors import InputError
    from beltscape.files.exchange import import_rig
    from beltscape.files.rig_json import write_rig
    from beltscape.files.rig_limits import find_oddities, find_refusal

    rig, kind = import_rig(arguments.source, reporter, kind=arguments.format, core=arguments.core)
    refusal = find_refusal(rig)
    if refusal is not None:
        raise InputError(f"{arguments.source}: {refusal}")
    for line in find_oddities(rig):
        reporter.warn(f"{arguments.source}: {line}")
    write_rig(arguments.out, rig)
    cameras = {
        name: {
            "size_px": camera.size_px,
            "focal_px": camera.focal_px,
            "center_in_core_mm": rig.cam_from_core[name].center_mm,
        }
        for name, camera in rig.cameras.items()
    }
    return {"format": kind, "core": rig.core, "cameras": cameras, "rig": arguments.out}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    lines = [f"{result['format']}: {len(result['cameras'])} cameras about {result['core']} → {result['rig']}"]
    for name, camera in result["cameras"].items():
        (width, height), (fx, fy) = camera["size_px"], camera["focal_px"]
        x, y, z = camera["center_in_core_mm"]
        lines.append(
            f"  {name:<14} {width}×{height} px, focal {fx:.1f}, {fy:.1f} px, at {x:.1f}, {y:.1f}, {z:.1f} mm"
        )
    return "\n".join(lines)
