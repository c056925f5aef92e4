"""``beltscape measure belt DIR [--frames 000 001 ...] --out belt.json``: learns the empty belt."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_file
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("reconstruction", type=Path, help="reconstruction DIR of the empty belt")
    parser.add_argument("--frames", nargs="+", metavar="FRAME", help="frames to learn from (default: all)")
    add_output_file(parser, "belt.json to write; its report lies beside it", "belt.json", required=True)


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Measure the empty belt and write belt.json and its report."""
    from beltscape.pipeline.measuring.belt import make_belt_document, measure_empty_belt, write_belt_files

    belt, camera = measure_empty_belt(arguments.reconstruction, arguments.frames, reporter)
    page = write_belt_files(arguments.out, belt, camera)
    return {**make_belt_document(belt), "belt": arguments.out, "report": page}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    x0, x1 = result["across_mm"]
    off = result["misaligned_mm"]
    is_known = off is not None and isfinite(off)
    ends = (
        f"{off:+.1f} mm, σ {result['misaligned_sigma_mm']:.1f} mm"
        if is_known
        else "unknown: its ends were not seen"
    )
    return (
        f"belt   x {x0:.1f} to {x1:.1f} mm, scatter {result['noise_mm']:.4f} mm, {result['frames']} frames\n"
        f"upright to {result['tilt_sigma_deg']:.5f}°, cross-section to {result['section_sigma_mm']:.4f} mm\n"
        f"runs off {ends}\nfile   {result['belt']}\nreport {result['report']}"
    )
