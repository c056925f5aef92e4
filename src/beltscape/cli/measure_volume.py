"""``beltscape measure volume DIR/<frame> --empty DIR/<frame> [--across A B --along A B]``."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import ordered_range, settings
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("loaded", type=Path, help="frame folder DIR/<frame> of the loaded belt")
    parser.add_argument("--empty", type=Path, required=True, help="frame folder of the empty belt")
    parser.add_argument("--across", nargs=2, type=float, metavar=("A", "B"), help="box across the belt, mm")
    parser.add_argument("--along", nargs=2, type=float, metavar=("A", "B"), help="box along the belt, mm")
    parser.add_argument(
        "--profile-every", type=float, default=50.0, metavar="MM", help="a cross-section every so often"
    )
    parser.add_argument(
        "--cell", type=float, metavar="MM", help="edge of a grid cell (default: from the density)"
    )
    parser.add_argument(
        "--out", type=Path, help="folder for volume.json, load.tiff, profiles.csv, report.html"
    )


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Measure the volume."""
    from beltscape.measure.settings import VolumeSettings
    from beltscape.pipeline.volume import volume_document, volume_of_frames, write_volume

    volume = volume_of_frames(
        arguments.loaded,
        arguments.empty,
        settings(VolumeSettings, cell_mm=arguments.cell, profile_every_mm=arguments.profile_every),
        across_mm=ordered_range("--across", arguments.across),
        along_mm=ordered_range("--along", arguments.along),
    )
    reporter.step("measuring volume", 1, 1)
    if arguments.out is not None:
        write_volume(arguments.out, volume)
    return {**volume_document(volume), "report": arguments.out and arguments.out / "report.html"}


def summary(result: Mapping[str, Any]) -> str:
    """The result in a few lines."""
    (x0, x1), (y0, y1) = result["across_mm"], result["along_mm"]
    text = (
        f"volume {result['volume_mm3'] * 1e-6:.4f} l, σ {result['sigma_mm3'] * 1e-6:.4f} l\n"
        f"box    x {x0:.1f} to {x1:.1f} mm, y {y0:.1f} to {y1:.1f} mm, {result['coverage']:.1%} of it measured"
    )
    return text + (f"\nreport {result['report']}" if result["report"] else "")
