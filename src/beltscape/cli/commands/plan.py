"""``beltscape plan [--plan plan.toml] [--belt-width MM …] --out DIR``: plans a rig before it is built."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from beltscape.cli.arguments import add_output_folder
from beltscape.core.progress import Reporter


class _Option(NamedTuple):
    flag: str
    key: str
    kind: Any
    unit: str | tuple[str, ...]
    help: str


_OPTIONS = (
    _Option("--belt-width", "belt.width_mm", float, "MM", "of the belt along its surface (800)"),
    _Option("--span", "belt.span_mm", float, "MM", "w of Eq. 26: between the side idlers' vertices (780)"),
    _Option("--flat", "belt.flat_mm", float, "MM", "level middle of the trough (300)"),
    _Option("--material", "belt.material_mm", float, ("LOW", "HIGH"), "heights to measure, mm (0 150)"),
    _Option("--top-width", "belt.top_width_mm", float, "MM", "of the load at its highest (the span)"),
    _Option("--speed", "belt.speed_m_s", float, "M/S", "of the belt (2)"),
    _Option("--pixels", "camera.size_px", int, ("W", "H"), "of the camera (2448 2048)"),
    _Option("--pitch", "camera.pitch_um", float, "UM", "of its pixels (3.45)"),
    _Option("--focal", "camera.focal_mm", float, "MM", "of the lens (8)"),
    _Option("--f-number", "camera.f_number", float, "N", "of the lens (2.8)"),
    _Option("--angle", "camera.angle_deg", float, "DEG", "horizontal angle of view as its maker states it"),
    _Option("--max-fps", "camera.max_fps", float, "FPS", "of the camera (79.1)"),
    _Option("--auxiliaries", "rig.auxiliaries", int, "N", "cameras around the core (4)"),
    _Option("--height", "rig.height_mm", float, "MM", "of the core above the belt (recommended)"),
    _Option("--max-height", "rig.max_height_mm", float, "MM", "room above the belt (3000)"),
    _Option("--baseline", "rig.baseline_mm", float, "MM", "from core to auxiliaries (chosen)"),
    _Option("--exposure", "light.exposure_us", float, "US", "(the longest that motion blur allows)"),
    _Option("--lumens", "light.projector_lm", float, "LM", "of the projector (3000)"),
    _Option("--ambient", "light.ambient_lux", float, "LUX", "on the belt (300)"),
    _Option("--reflectance", "light.reflectance", float, "R", "of the darkest material (0.05)"),
    _Option("--matching-sigma", "precision.matching_sigma_px", float, "PX", "of a matched point (0.03)"),
    _Option("--patch", "precision.patch_px", int, "PX", "edge of the matched patch (21)"),
    _Option("--calibration-sigma", "precision.calibration_sigma_mm", float, "MM", "of depth, if known (0)"),
    _Option("--frames-per-point", "frames_per_point", int, "K", "frames that see each piece of belt (3)"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "--plan", type=Path, metavar="TOML", help="plan.toml with all settings; options go before it"
    )
    for option in _OPTIONS:
        several = isinstance(option.unit, tuple)
        parser.add_argument(
            option.flag,
            type=option.kind,
            nargs=len(option.unit) if several else None,
            metavar=option.unit,
            help=option.help,
        )
    add_output_folder(parser, "folder for plan.json, rig.json, report.html")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Plan the rig."""
    from beltscape.pipeline.plan import read_plan_settings, write_plan
    from beltscape.plan.plan import make_plan, plan_to_document

    plan = make_plan(read_plan_settings(arguments.plan, _read_overrides(arguments)))
    for warning in plan.warnings:
        reporter.warn(warning)
    if arguments.out is not None:
        write_plan(arguments.out, plan)
    return {**plan_to_document(plan), "report": arguments.out and arguments.out / "report.html"}


def _read_overrides(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options given on the command line, in plan.toml's form."""
    overrides: dict[str, Any] = {}
    for option in _OPTIONS:
        value = getattr(arguments, option.flag[2:].replace("-", "_"))
        if value is None:
            continue
        *tables, key = option.key.split(".")
        place = overrides.setdefault(tables[0], {}) if tables else overrides
        place[key] = value
    return overrides


def summary(result: Mapping[str, Any]) -> str:
    """Format the result in a few lines."""
    hang, rig, move, light = (result[key] for key in ("mounting", "rig", "motion", "light"))
    sigma, edges = result["depth_sigma"], result["planes"][1]
    count = len(rig["cameras"])
    lines = [
        f"Eq. 26    {hang['eq26_mm']:.1f} mm above the idlers' vertices at {hang['angle_deg']:.2f}°",
        f"height    core {hang['above_belt_mm']:.0f} mm above the belt, recommended "
        f"{hang['recommended_above_belt_mm']:.0f} mm",
        f"cameras   {count}: {count - 1} at {rig['baseline_mm']:.0f} mm from the core, tilted by "
        f"{rig['tilt_deg']:.1f}°",
        f"coverage  {100 * edges['seen_by_at_least'][1]:.1f} % of what the core sees of the belt is seen by another "
        f"camera, {100 * edges['seen_by_at_least'][-1]:.1f} % by all",
        f"pixel     {edges['pixel_mm'][rig['core']][1]:.3f} mm at the belt's edges",
        f"depth σ   {sigma['median_mm']:.3f} mm with {sigma['matching_sigma_px']:g} px of matching noise, "
        f"{sigma['in_this_light_mm']:.3f} mm in this light",
        f"exposure  {move['exposure_us']:.0f} µs: {move['blur_px']:.2f} px of blur, SNR {light['snr']:.1f}",
        f"frames    {move['gap_free_fps']:.1f} per second without gaps, {move['fps']:.1f} with fusion, "
        f"{move['data_mb_s']:.0f} MB/s; about {move['cores']:.0f} processor cores with the preset fast",
    ]
    return "\n".join(lines) + (f"\nreport    {result['report']}" if result["report"] else "")
