"""``beltscape measure features DIR/<frame> --module module.toml``: measures a calibration module."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from math import isnan
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_folder
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("frame", type=Path, help="frame folder DIR/<frame> that shows the module")
    parser.add_argument("--module", type=Path, required=True, help="module.toml with its nominal dimensions")
    parser.add_argument(
        "--image",
        type=Path,
        help="the core camera's image of the same still scene with the projector off, as taken: sharper edges",
    )
    add_output_folder(parser, "folder for features.json, features.csv, report.html")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Measure the module's features."""
    from beltscape.pipeline.measuring.belt import warn_of_camera_faults
    from beltscape.pipeline.measuring.features import (
        make_features_document,
        measure_features_of_frame,
        write_features,
    )

    frame, measured = measure_features_of_frame(arguments.frame, arguments.module, arguments.image)
    warn_of_camera_faults(frame, reporter)
    reporter.step("measuring features", 1, 1)
    for warning in measured.warnings:
        reporter.warn(warning)
    if arguments.out is not None:
        write_features(arguments.out, frame, measured)
    return {**make_features_document(measured), "report": arguments.out and arguments.out / "report.html"}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    lines = [f"{'':24}{'':18}{'nominal':>9}{'measured':>11}{'error':>9}{'σ':>8}  mm"]
    for q in result["features"]:
        lines.append(f"{q['name']:24}{q['quantity']:18}{q['nominal_mm']:9.3f}" + _measured(q))
    return "\n".join(lines) + (f"\nreport {result['report']}" if result["report"] else "")


def _measured(quantity: Mapping[str, Any]) -> str:
    if isnan(quantity["measured_mm"]):
        return f"{'not measured':>28}"
    error = quantity["measured_mm"] - quantity["nominal_mm"]
    return f"{quantity['measured_mm']:11.3f}{error:+9.3f}{quantity['sigma_mm']:8.3f}"
