"""``beltscape measure flow CAPTURE --rig rig.json --empty DIR/<frame>``: measures the flow on a moving belt."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltscape.cli.arguments import (
    add_empty_belt,
    add_output_folder,
    add_preset,
    make_settings,
    require_plausible,
)
from beltscape.core.errors import SettingsError
from beltscape.core.progress import Reporter
from beltscape.core.quantities import CELL, DENSITY, FRAME_RATE, LOAD_HEIGHT

if TYPE_CHECKING:
    from beltscape.measure.flow.density import Density

_MISSING_DIRECTION = "?"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("capture", type=Path, help="folder <capture>/<camera>/<frame>.png of a moving belt")
    parser.add_argument("--rig", type=Path, required=True, help="rig.json of beltscape calibrate")
    add_empty_belt(parser)
    parser.add_argument(
        "--encoder", type=Path, help="encoder.csv: frame,timestamp_s,belt_position_mm (default: the material)"
    )
    parser.add_argument(
        "--frames-per-s", type=float, metavar="HZ", help="the trigger's, where no encoder.csv gives the times"
    )
    parser.add_argument("--density", type=float, metavar="KG_M3", help="bulk density")
    parser.add_argument("--density-table", type=Path, help="CSV timestamp_s,density_kg_m3[,sigma_kg_m3]")
    parser.add_argument("--products", type=Path, help="TOML [name] density_kg_m3, sigma_kg_m3")
    parser.add_argument("--product", metavar="NAME", help="one of the products")
    # argparse reads -y as an option, so it is declared as one, and --direction may precede it without a value
    parser.add_argument(
        "--direction", nargs="?", const=_MISSING_DIRECTION, metavar="+y|-y",
        help="which way the belt travels (default: found from the material)",
    )  # fmt: skip
    parser.add_argument("-y", dest="direction", action="store_const", const="-y", help=argparse.SUPPRESS)
    add_preset(parser, "matching")
    parser.add_argument(
        "--load",
        type=float,
        metavar="MM",
        help="height that a load may reach (default: looked for in the frames)",
    )
    parser.add_argument("--cell", type=float, metavar="MM", help="edge of a grid cell (default: one pixel)")
    parser.add_argument(
        "--belt-cell",
        type=float,
        metavar="MM",
        help="edge of a cell of belt.tiff (default: one pixel; a long belt's up to 4)",
    )
    add_output_folder(parser, "folder for flow.csv, flow.json, report.html", required=True)


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Measure the flow and write it."""
    from beltscape.files.atomic import ensure_output_folder
    from beltscape.files.rig_json import read_rig
    from beltscape.measure.flow.settings import FlowSettings
    from beltscape.pipeline.measuring.belt import describe_measured_by
    from beltscape.pipeline.measuring.flow import measure_flow_of_capture, write_flow_result

    if arguments.direction == _MISSING_DIRECTION:
        raise SettingsError("--direction: give +y or -y, along or against the belt frame's y axis")
    require_plausible("--frames-per-s", arguments.frames_per_s, FRAME_RATE)
    require_plausible("--load", arguments.load, LOAD_HEIGHT)
    require_plausible("--belt-cell", arguments.belt_cell, CELL)
    chosen = make_settings(FlowSettings, direction=arguments.direction, cell_mm=arguments.cell)
    density = _density(arguments)
    ensure_output_folder(arguments.out)
    flow = measure_flow_of_capture(
        arguments.capture,
        read_rig(arguments.rig),
        arguments.empty,
        reporter,
        encoder=arguments.encoder,
        frames_per_s=arguments.frames_per_s,
        density=density,
        settings=chosen,
        preset=arguments.preset,
        load_mm=arguments.load,
        belt_cell_mm=arguments.belt_cell,
    )
    warnings = getattr(reporter, "warnings", ())
    measured_by = describe_measured_by(arguments.rig, arguments.empty)
    return write_flow_result(arguments.out, flow, density, warnings, measured_by)


def _density(arguments: argparse.Namespace) -> Density:
    """Return the bulk density, which is given in one of three ways."""
    from beltscape.measure.flow.density import Density, make_unknown_density
    from beltscape.pipeline.live.project import read_density_over_time, read_product_density

    given = [
        name
        for name in ("density", "density_table", "product", "products")
        if getattr(arguments, name) is not None
    ]
    if sorted(given) == ["product", "products"]:
        return read_product_density(arguments.products, arguments.product)
    if len(given) > 1:
        options = " and ".join(f"--{name.replace('_', '-')}" for name in given)
        raise SettingsError(f"{options}: give the density in one way only")
    if given in (["product"], ["products"]):
        raise SettingsError("--product NAME goes with --products FILE: give both")
    if arguments.density is not None:
        require_plausible("--density", arguments.density, DENSITY)
        return Density.constant(arguments.density)
    if arguments.density_table is not None:
        return read_density_over_time(arguments.density_table)
    return make_unknown_density()


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    totals, encoder = result["totals"], result["encoder"]
    lines = [
        f"volume {totals['volume_mm3'] * 1e-6:.3f} l, σ {totals['sigma_mm3'] * 1e-6:.3f} l, on "
        f"{totals['length_mm'] / 1000:.3f} m of belt in {result['frame_count']} frames",
        f"motion {result['motion_evidence']['statement']}",
    ]
    if totals["mass_t"] is not None:
        lines.append(f"mass   {totals['mass_t'] * 1000:.2f} kg, σ {totals['mass_sigma_t'] * 1000:.2f} kg")
    if totals["mean_volume_flow_m3_h"] is not None:
        lines.append(f"flow   {totals['mean_volume_flow_m3_h']:.2f} m³/h on average")
    if encoder["compared"]:
        lines.append(
            f"encoder over material {encoder['ratio']:.5f}, σ {encoder['sigma']:.5f}, "
            f"over {encoder['compared']} steps"
        )
    quality = ", ".join(f"{count} {name}" for name, count in result["quality"].items() if count)
    lines.append(f"strips {quality}; {totals['coverage']:.1%} of the belt measured")
    return "\n".join([*lines, f"report {result['report']}"])
