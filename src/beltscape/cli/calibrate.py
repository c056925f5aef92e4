"""``beltscape calibrate CAPTURE --board board.toml --out DIR``: calibrates a rig from images of a board."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_folder
from beltscape.cli.fit import format_findings
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("capture", type=Path, help="folder <capture>/<camera>/<frame>.png of board views")
    parser.add_argument("--board", type=Path, required=True, help="board.toml")
    parser.add_argument("--core", help="core camera (default: the most central one)")
    parser.add_argument(
        "--intrinsics", type=Path, metavar="PATH",
        help="use these intrinsics: a rig.json, or a file or folder that `beltscape import` reads",
    )  # fmt: skip
    add_output_folder(parser, "folder for rig.json and the report", required=True)


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Calibrate and write rig.json, calibration.json, report.html."""
    from beltscape.files.exchange import read_intrinsics
    from beltscape.files.folders.atomic import ensure_output_folder
    from beltscape.pipeline.calibrating.calibration import calibrate
    from beltscape.pipeline.calibrating.calibration_files import make_calibration_document, write_calibration
    from beltscape.pipeline.calibrating.known_intrinsics import KnownIntrinsics
    from beltscape.target.board import read_board

    board = read_board(arguments.board)
    out = ensure_output_folder(arguments.out)
    given = arguments.intrinsics
    known = KnownIntrinsics(read_intrinsics(given, reporter), str(given)) if given else None
    calibration = calibrate(arguments.capture, board, arguments.core, reporter, known=known)
    write_calibration(out, calibration)
    document = make_calibration_document(calibration)
    return {**document, "rig": out / "rig.json", "report": out / "report.html"}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines, findings against the fit first."""
    score, kind = (result["held_out"], "held out") if result["held_out"] else (result["training"], "training")
    given = [name for name, camera in result["cameras"].items() if camera["intrinsics"] == "given"]
    return "\n".join(
        [
            *format_findings(result["fit"]),
            f"{len(result['cameras'])} cameras about {result['core']}; {kind}: {score['rms_px']:.3f} px RMS, "
            f"{score['median_px']:.3f} px median, square edge {score['square_bias_mm']:+z.4f} mm, "
            f"RMS {score['square_rms_mm']:.4f} mm",
            *([f"intrinsics given: {', '.join(given)}"] if given else []),
            f"rig     {result['rig']}",
            f"report  {result['report']}",
        ]
    )
