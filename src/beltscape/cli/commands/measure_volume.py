"""``beltscape measure volume DIR/<frame> --empty DIR/<frame>``: measures the volume of a load."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_empty_belt, add_output_folder, make_settings, require_ordered_range
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("loaded", type=Path, help="frame folder DIR/<frame> of the loaded belt")
    add_empty_belt(parser)
    parser.add_argument("--across", nargs=2, type=float, metavar=("A", "B"), help="box across the belt, mm")
    parser.add_argument("--along", nargs=2, type=float, metavar=("A", "B"), help="box along the belt, mm")
    parser.add_argument(
        "--profile-every", type=float, default=50.0, metavar="MM", help="distance between cross-sections (50)"
    )
    parser.add_argument(
        "--cell", type=float, metavar="MM", help="edge of a grid cell (default: from the density)"
    )
    parser.add_argument(
        "--surcharge", type=float, default=20.0, metavar="DEG",
        help="angle at which the load of a full belt rises from its sides (20)",
    )  # fmt: skip
    add_output_folder(parser, "folder for volume.json, load.tiff, meshes, profiles.csv, report.html")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Measure the volume."""
    from beltscape.measure.volume.load import require_box_side
    from beltscape.measure.volume.settings import VolumeSettings
    from beltscape.pipeline.measuring.volume import (
        make_volume_document,
        measure_volume_of_frames,
        write_volume,
    )

    across_mm = require_ordered_range("--across", arguments.across)
    along_mm = require_ordered_range("--along", arguments.along)
    require_box_side("across", across_mm)
    require_box_side("along", along_mm)
    volume = measure_volume_of_frames(
        arguments.loaded,
        arguments.empty,
        make_settings(
            VolumeSettings,
            cell_mm=arguments.cell,
            profile_every_mm=arguments.profile_every,
            surcharge_deg=arguments.surcharge,
        ),
        across_mm=across_mm,
        along_mm=along_mm,
        reporter=reporter,
    )
    reporter.step("measuring volume", 1, 1)
    if arguments.out is not None:
        write_volume(arguments.out, volume)
    return {**make_volume_document(volume), "report": arguments.out and arguments.out / "report.html"}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    (x0, x1), (y0, y1) = result["across_mm"], result["along_mm"]
    text = (
        f"volume {result['volume_mm3'] * 1e-6:.4f} l, σ {result['sigma_mm3'] * 1e-6:.4f} l\n"
        f"box    x {x0:.1f} to {x1:.1f} mm, y {y0:.1f} to {y1:.1f} mm, {result['coverage']:.1%} of it measured"
    )
    centre, fill, highest = result["centre_of_gravity"], result["fill"], result["highest"]
    if centre:
        (x, y, z), (sx, sy, sz) = centre["place_mm"], centre["sigma_mm"]
        text += f"\ncentre x {x:.1f}, y {y:.1f}, z {z:.1f} mm, σ {sx:.1f}, {sy:.1f}, {sz:.1f} mm; "
        text += f"{centre['off_middle_mm']:+.1f} mm off the belt's middle"
    part = "" if fill["whole_belt_seen"] else " (of the part of the belt that was seen)"
    if fill["level"] is None:
        text += (
            "\nfill   unknown: the empty belt's shape holds no load; learn it again (beltscape measure belt)"
        )
    else:
        text += f"\nfill   {fill['level']:.1%} of {fill['capacity_mm2'] * 1e-2:.0f} cm²{part}"
    if highest:
        text += f"; highest {highest['height_mm']:.1f} mm"
    return text + (f"\nreport {result['report']}" if result["report"] else "")
