"""``beltscape measure belt DIR [--frames 000 001 ...] [--width MM] --out belt.json``: learns the empty belt."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_file, make_settings, require_ordered_range
from beltscape.core.errors import SettingsError
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("reconstruction", type=Path, help="reconstruction DIR of the empty belt")
    parser.add_argument("--frames", nargs="+", metavar="FRAME", help="frames to learn from (default: all)")
    ends = parser.add_mutually_exclusive_group()
    ends.add_argument(
        "--width", type=float, metavar="MM",
        help="width of the belt along its surface, for ends that are not seen",
    )  # fmt: skip
    ends.add_argument(
        "--across",
        nargs=2,
        type=float,
        metavar=("A", "B"),
        help="ends of the belt in x, mm of the belt frame",
    )
    parser.add_argument(
        "--region", metavar="POINTS",
        help='polygon that contains the belt, in pixels of preview.png: "u,v u,v u,v …", or a file with these pairs',
    )  # fmt: skip
    parser.add_argument(
        "--travel", type=float, metavar="DEG",
        help="travel of a flat belt without edges in view: its angle to the columns of preview.png, clockwise",
    )  # fmt: skip
    add_output_file(parser, "belt.json to write; its report lies beside it", "belt.json", required=True)


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Measure the empty belt and write belt.json and its report."""
    from beltscape.measure.belt.settings import GivenBelt
    from beltscape.pipeline.measuring.belt import make_belt_document, measure_empty_belt, write_belt_files

    given = make_settings(
        GivenBelt,
        width_mm=arguments.width,
        across_mm=require_ordered_range("--across", arguments.across),
        region_px=None if arguments.region is None else _parse_region(arguments.region),
        travel_deg=arguments.travel,
    )
    belt, depth = measure_empty_belt(arguments.reconstruction, arguments.frames, reporter, given)
    page = write_belt_files(arguments.out, belt, depth)
    return {**make_belt_document(belt), "belt": arguments.out, "report": page}


def _parse_region(text: str) -> tuple[tuple[float, float], ...]:
    """Return the corners of "u,v u,v …" or of a file with such pairs; SettingsError with the first wrong one."""
    path = Path(text)
    source = f"--region {text!r}"
    if not text[:1].isdigit() and not path.is_file():
        raise SettingsError(f'{source}: neither pairs "u,v u,v u,v" of pixels nor a file with these')
    words = (path.read_text("utf-8", "replace") if path.is_file() else text).replace(";", " ").split()
    corners: list[tuple[float, float]] = []
    for word in words:
        parts = word.split(",")
        try:
            u, v = (float(part) for part in parts)
        except ValueError:
            raise SettingsError(f"{source}: {word!r} is no pair u,v of pixels, such as 120,80") from None
        if not (isfinite(u) and isfinite(v)):
            raise SettingsError(f"{source}: {word!r} must be two finite numbers")
        corners.append((u, v))
    if len(corners) < 3:
        raise SettingsError(f"{source}: has {len(corners)} corners; a polygon needs at least 3")
    return tuple(corners)


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    x0, x1 = result["across_mm"]
    off = result["misaligned_mm"]
    is_known = off is not None and isfinite(off)
    ends = (
        f"{off:+.1f} mm, σ {result['misaligned_sigma_mm']:.1f} mm"
        if is_known
        else "unknown: its ends were not both seen"
    )
    left, right = result["ends"]
    return (
        f"belt   x {x0:.1f} to {x1:.1f} mm, scatter {result['noise_mm']:.4f} mm, {result['frames']} frames\n"
        f"ends   left {left}, right {right}; {result['width_mm']:.0f} mm apart along the surface\n"
        f"upright to {result['tilt_sigma_deg']:.5f}°, cross-section to {result['section_sigma_mm']:.4f} mm\n"
        f"runs off {ends}\nfile   {result['belt']}\nreport {result['report']}"
    )
