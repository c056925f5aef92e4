"""``beltscape measure zero DIR --empty belt.json --out zero.json``: sets the zero on the empty running belt."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_file, make_settings
from beltscape.core.progress import Reporter

_LIMIT_MM = 2.0
"""Default of ``--set-limit``: a larger shift is rather a fault than wear. Chosen."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("reconstruction", type=Path, help="reconstruction DIR of the empty running belt")
    parser.add_argument("--empty", type=Path, required=True, help="the belt.json whose zero is to be set")
    parser.add_argument("--frames", nargs="+", metavar="FRAME", help="frames to measure (default: all)")
    parser.add_argument(
        "--set-limit",
        type=float,
        default=_LIMIT_MM,
        metavar="MM",
        help=f"refuse a larger rise, fall or tilt (default: {_LIMIT_MM:g})",
    )
    add_output_file(parser, "belt.json to write; its report lies beside it", "belt.json", required=True)


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Measure the empty belt's motion since it was learned, and write the belt.json with the new zero."""
    from beltscape.health.settings import BeltLimits
    from beltscape.pipeline.measuring.zero import make_zero_document, set_zero, write_zero_files

    limits = make_settings(BeltLimits, set_limit_mm=arguments.set_limit)
    setting = set_zero(arguments.reconstruction, arguments.empty, arguments.frames, limits, reporter)
    page = write_zero_files(arguments.out, arguments.empty, setting)
    return {**make_zero_document(setting), "belt": arguments.out, "report": page}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    return (
        f"zero   {result['offset_mm']:+.3f} mm, σ {result['offset_sigma_mm']:.3f} mm, "
        f"tilt {result['tilt_mm']:+.2f} mm at the edge, {result['frames']} frames\n"
        f"file   {result['belt']}\nreport {result['report']}"
    )
