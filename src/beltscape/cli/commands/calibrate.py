"""``beltscape calibrate CAPTURE --board board.toml --out DIR``: calibrates a rig from images of a board.

``beltscape calibrate intrinsics CAPTURE``, with the word before the folder, calibrates each camera by itself.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltscape.cli.arguments import add_output_folder
from beltscape.cli.output import explain_failure
from beltscape.cli.terminal import format_findings, format_squares
from beltscape.core.errors import CalibrationError, SettingsError
from beltscape.core.progress import Reporter

if TYPE_CHECKING:
    from beltscape.calibration.result import Calibration
    from beltscape.pipeline.calibrating.intrinsics import KnownIntrinsics
    from beltscape.target.board import Board

REFUSED_PICTURE = "coverage_refused.png"
"""Picture of the part of the images that the board never reached, if that ends the calibration."""
INTRINSICS = "intrinsics"
"""The word before the folder that selects intrinsics of single cameras."""


class _SplitMode(argparse.Action):
    """Take ``intrinsics CAPTURE`` or ``CAPTURE``: the word before the folder selects the mode."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,  # noqa: ARG002
    ) -> None:
        """Set ``capture`` and ``mode``."""
        words = list(values or ())
        if len(words) > 2 or (len(words) == 2 and words[0] != INTRINSICS):
            parser.error(
                f"{' '.join(words)}: give one capture folder, or the word {INTRINSICS} and a folder of board views"
            )
        namespace.capture, namespace.mode = Path(words[-1]), INTRINSICS if len(words) == 2 else "rig"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.usage = "%(prog)s [intrinsics] CAPTURE --board BOARD --out DIR [options]"
    parser.add_argument(
        "capture", nargs="+", metavar="CAPTURE", action=_SplitMode,
        help="folder <capture>/<camera>/<frame>.png of board views, or of one video per camera, <camera>.mp4; after "
        "the word intrinsics: views that each camera took by itself, or a folder of one camera's images, for "
        "intrinsics.json",
    )  # fmt: skip
    parser.add_argument("--board", type=Path, required=True, help="board.toml")
    parser.add_argument("--core", help="core camera (default: the most central one)")
    parser.add_argument(
        "--intrinsics", type=Path, metavar="PATH",
        help="use these intrinsics: an intrinsics.json, a rig.json, a file or folder that `beltscape import` reads, "
        "or a folder of views that each camera took by itself",
    )  # fmt: skip
    parser.add_argument(
        "--intrinsics-as", choices=("held", "prior"),
        help="hold these intrinsics (default), or let the views improve them within their covariance",
    )  # fmt: skip
    parser.add_argument(
        "--add-to", type=Path, metavar="RIG",
        help="keep this rig.json's cameras as they are, and calibrate only those that it lacks",
    )  # fmt: skip
    parser.add_argument(
        "--replace",
        action="append",
        metavar="CAMERA",
        help="with --add-to: calibrate this camera anew; repeatable",
    )
    parser.add_argument(
        "--lens-model", choices=("auto", "brown", "rational", "thin_prism", "tilted", "fisheye"), default="auto",
        help="lens model of the cameras without given intrinsics; auto (default): each camera's views choose among "
        "brown, rational, fisheye and tilted",
    )  # fmt: skip
    parser.add_argument(
        "--belt", type=Path, metavar="FILE",
        help="plan.toml, project.toml or belt.json: the volume over the belt that the rig is to measure; the board "
        "must have reached the part of the images that sees it (default: the core camera's whole view)",
    )  # fmt: skip
    add_output_folder(parser, "folder for rig.json and the report, or for intrinsics.json", required=True)


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Calibrate and write rig.json, calibration.json, report.html; or intrinsics.json."""
    from beltscape.files.atomic import ensure_output_folder
    from beltscape.pipeline.calibrating.calibration_files import make_calibration_document, write_calibration
    from beltscape.pipeline.calibrating.intrinsics import read_known_intrinsics
    from beltscape.pipeline.calibrating.views import locate_capture
    from beltscape.target.board import read_board

    _check_options(arguments)
    board = read_board(arguments.board)
    out = ensure_output_folder(arguments.out)
    single = arguments.mode == INTRINSICS
    folder = locate_capture(arguments.capture, out, reporter, synchronous=not single)
    if single:
        return _run_intrinsics(folder, board, out, reporter, arguments.lens_model)
    given = arguments.intrinsics
    use = arguments.intrinsics_as or "held"
    known = read_known_intrinsics(given, board, reporter, use=use) if given else None
    if arguments.add_to:
        return _run_extension(arguments, folder, board, known, out, reporter)
    calibration = _calibrate_rig(arguments, folder, board, known, reporter)
    write_calibration(out, calibration)
    document = make_calibration_document(calibration)
    return {**document, "rig": out / "rig.json", "report": out / "report.html"}


def _calibrate_rig(
    arguments: argparse.Namespace,
    folder: Path,
    board: Board,
    known: KnownIntrinsics | None,
    reporter: Reporter,
) -> Calibration:
    """Calibrate; draw the picture of what the board never reached, where that ends the calibration."""
    from beltscape.calibration.assessment.coverage import UncoveredVolumeError
    from beltscape.pipeline.calibrating.calibration import calibrate
    from beltscape.pipeline.calibrating.measuring_volume import read_measuring_volume
    from beltscape.report.calibration_plots import coverage_picture

    volume = read_measuring_volume(arguments.belt) if arguments.belt else None
    try:
        return calibrate(
            folder,
            board,
            arguments.core,
            reporter,
            known=known,
            lens_model=arguments.lens_model,
            volume=volume,
        )
    except UncoveredVolumeError as error:
        picture = explain_failure(
            arguments, REFUSED_PICTURE, coverage_picture(error.coverage, f"Refused: {error}.")
        )
        raise CalibrationError(f"{error}; {picture} shows where") from error


def _check_options(arguments: argparse.Namespace) -> None:
    """Raise SettingsError for options that have no effect."""
    if arguments.intrinsics_as and not arguments.intrinsics:
        raise SettingsError(
            f"--intrinsics-as {arguments.intrinsics_as}: give the intrinsics, with --intrinsics PATH"
        )
    if arguments.mode == INTRINSICS:
        _refuse_options(arguments, ("core", "intrinsics", "add_to", "replace", "belt"), "for single cameras")
    if arguments.add_to:
        _refuse_options(arguments, ("core", "belt"), "with --add-to, which keeps the rig's core")
    elif arguments.replace:
        raise SettingsError(f"--replace {arguments.replace[0]}: give the rig, with --add-to rig.json")


def _refuse_options(arguments: argparse.Namespace, options: Sequence[str], where: str) -> None:
    for option in options:
        if getattr(arguments, option) is not None:
            raise SettingsError(f"--{option.replace('_', '-')} has no meaning {where}; leave it out")


def _run_intrinsics(
    folder: Path, board: Board, out: Path, reporter: Reporter, lens_model: str
) -> Mapping[str, Any]:
    from beltscape.files.intrinsics_json import intrinsics_document
    from beltscape.pipeline.calibrating.intrinsics import calibrate_intrinsics, write_intrinsics_calibration

    calibration = calibrate_intrinsics(folder, board, reporter, lens_model=lens_model)
    path = write_intrinsics_calibration(out, calibration)
    return {
        **intrinsics_document(calibration.to_intrinsics()),
        "notes": calibration.notes,
        "intrinsics": path,
    }


def _run_extension(
    arguments: argparse.Namespace,
    folder: Path,
    board: Board,
    known: KnownIntrinsics | None,
    out: Path,
    reporter: Reporter,
) -> Mapping[str, Any]:
    from beltscape.files.rig_json import read_rig
    from beltscape.pipeline.calibrating.extension import extend_rig, make_extension_document, write_extension

    rig, replaced = read_rig(arguments.add_to), tuple(arguments.replace or ())
    extension = extend_rig(
        folder, rig, board, reporter, replaced=replaced, known=known, lens_model=arguments.lens_model
    )
    path = write_extension(out, extension)
    return {**make_extension_document(extension), "rig": path}


def _summarise_extension(result: Mapping[str, Any]) -> str:
    score, kind = (result["held_out"], "held out") if result["held_out"] else (result["training"], "training")
    return "\n".join(
        [
            *format_findings(result["fit"]),
            f"calibrated {', '.join(result['new'])} with {', '.join(result['held'])} held; {kind}: "
            f"{score['rms_px']:.3f} px RMS, {score['median_px']:.3f} px median",
            *(f"note: {note}" for note in result["notes"]),
            f"rig     {result['rig']}",
        ]
    )


def _summarise_intrinsics(result: Mapping[str, Any]) -> str:
    lines: list[str] = []
    for name, camera in result["cameras"].items():
        quality, focal = camera["quality"], camera["focal_px"]
        held_out: float = quality["held_out_rms_px"]
        lines.append(
            f"{name}: focal length {focal[0]:.2f} ± {quality['sigma']['fx']:.2f} px, {quality['views']} of "
            f"{quality['images']} images; training {quality['rms_px']:.3f} px RMS, held out "
            + ("unknown" if isnan(held_out) else f"{held_out:.3f} px")
        )
    notes = [f"note: {line}" for line in result["notes"]]
    return "\n".join([*lines, *notes, f"intrinsics  {result['intrinsics']}"])


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines, findings against the fit first."""
    if "intrinsics" in result:
        return _summarise_intrinsics(result)
    if "new" in result:
        return _summarise_extension(result)
    score, kind = (result["held_out"], "held out") if result["held_out"] else (result["training"], "training")
    origins = {name: camera["intrinsics"] for name, camera in result["cameras"].items()}
    given = [
        name + " (prior)" * (origin == "prior") for name, origin in origins.items() if origin != "estimated"
    ]
    return "\n".join(
        [
            *format_findings(result["fit"]),
            f"{len(result['cameras'])} cameras about {result['core']}; {kind}: {score['rms_px']:.3f} px RMS, "
            f"{score['median_px']:.3f} px median, {format_squares(score)}",
            *([f"intrinsics given: {', '.join(given)}"] if given else []),
            *([result["left_out"]["words"]] if result["left_out"]["corners"] else []),
            *(f"note: {note}" for note in result["notes"]),
            f"rig     {result['rig']}",
            f"report  {result['report']}",
        ]
    )
