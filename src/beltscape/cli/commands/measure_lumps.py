"""``beltscape measure lumps DIR/<frame>|FLOW [--oversize MM] [--sieves 10,20,40]``: measures the size of lumps."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from math import isnan
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_folder, make_settings
from beltscape.core.errors import SettingsError
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "loaded",
        type=Path,
        help="frame folder DIR/<frame> of the loaded belt, or the "
        "folder of beltscape measure flow: each lump of the moving belt once",
    )
    parser.add_argument(
        "--empty",
        type=Path,
        help="the empty belt: a frame folder, a reconstruction (all its frames), or a belt.json; places are then in "
        "the belt's frame",
    )
    parser.add_argument("--oversize", type=float, metavar="MM", help="alarm above this size")
    parser.add_argument(
        "--sieves", metavar="MM,MM,…", help="apertures of the sieve table (default: R10 series)"
    )
    add_output_folder(parser, "folder for lumps.json, lumps.csv, sieve.csv, labels.png, report.html")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Measure the lumps."""
    from beltscape.measure.lumps.settings import LumpSettings
    from beltscape.pipeline.measuring.belt import warn_of_camera_faults
    from beltscape.pipeline.measuring.lumps import make_lumps_document, measure_lumps_of_folder, write_lumps

    options = {"oversize_mm": arguments.oversize}
    if arguments.sieves is not None:
        options["sieves_mm"] = _sieves(arguments.sieves)
    measured = measure_lumps_of_folder(
        arguments.loaded, make_settings(LumpSettings, **options), empty=arguments.empty, reporter=reporter
    )
    if measured.frame is not None:
        warn_of_camera_faults(measured.frame, reporter)
    reporter.step("measuring lumps", 1, 1)
    if arguments.out is not None:
        write_lumps(arguments.out, measured)
    return {**make_lumps_document(measured.lumps), "report": arguments.out and arguments.out / "report.html"}


def _sieves(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise SettingsError(
            f"--sieves {text}: give apertures in mm with commas between, as 10,20,40"
        ) from error


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    lumps, share = result["lumps"], result["fines_share"]
    whole = sum(not lump["occluded"] and not lump["cut"] for lump in lumps)
    text = f"{len(lumps)} lumps, {whole} of them fully visible; below {result['smallest_mm']:.0f} mm is fines"
    if not isnan(share):
        text += f", {share:.0%} of the load's surface"
    sizes = result["distribution"]
    if sizes["count"]:
        parts = (
            f"{name} {sizes[f'{name}_mm']:.1f} ± {sizes[f'{name}_sigma_mm']:.1f}"
            for name in ("d10", "d50", "d80", "d90")
        )
        text += "\n" + ", ".join(parts) + " mm by mass, of the top layer"
    alarm = result["oversize"]
    if alarm is not None:
        verdict = "OVERSIZE" if alarm["oversize"] else "no oversize"
        text += f"\n{verdict}: a lump over {alarm['limit_mm']:g} mm with a probability of {alarm['probability']:.0%}"
    return text + (f"\nreport {result['report']}" if result["report"] else "")
