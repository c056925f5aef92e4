"""``beltscape target pattern|board --out DIR``: draws the speckle pattern, or a calibration board to print."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltscape.cli.arguments import add_output_folder
from beltscape.core.errors import SettingsError
from beltscape.core.progress import Reporter

if TYPE_CHECKING:
    from beltscape.target.board import PlanarBoard


_LENGTHS = {"square": "MM", "marker": "MM", "dictionary": "NAME", "tag": "MM", "spacing": "SHARE"}
"""Options of boards, and what they take."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the kinds of target and their arguments."""
    kinds = parser.add_subparsers(dest="target", required=True, metavar="TARGET")
    _add_pattern(kinds.add_parser("pattern", help="speckle pattern for the projector"))
    _add_board(kinds.add_parser("board", help="calibration board to print in true size"))


def _add_pattern(pattern: argparse.ArgumentParser) -> None:
    add_output_folder(pattern, "folder for pattern.* and quality.*", required=True)
    pattern.add_argument(
        "--preset",
        choices=("paper", "fine", "dense"),
        default="paper",
        help="25,000, 50,000 or 100,000 dots (default: paper, 25,000)",
    )
    pattern.add_argument("--dots", type=int, metavar="N", help="number of dots, instead of the preset's")
    pattern.add_argument(
        "--size", nargs=2, type=int, metavar=("W", "H"), default=(1920, 1200), help="px (default: 1920 1200)"
    )
    pattern.add_argument(
        "--d-min", type=float, metavar="PX", help="least distance of two dots (default: as large as fits)"
    )
    pattern.add_argument(
        "--radius",
        type=float,
        metavar="PX",
        help="of a dot (default: 0.34 d-min); a marker's is ten times it",
    )
    pattern.add_argument("--seed", type=int, default=0, metavar="N", help="another seed, another pattern")
    pattern.add_argument(
        "--grey",
        nargs=2,
        type=float,
        metavar=("LOW", "HIGH"),
        default=(1.0, 1.0),
        help="levels of the dots, 0 background to 1 dot colour (default: 1 1)",
    )
    pattern.add_argument("--dot-color", metavar="#RRGGBB", default="#FFD700", help="(default: #FFD700, gold)")
    pattern.add_argument("--background", metavar="#RRGGBB", default="#0A0A0A", help="(default: #0A0A0A)")
    pattern.add_argument("--marker-color", metavar="#RRGGBB", default="#FF0000", help="(default: #FF0000)")
    pattern.add_argument(
        "--bits", type=int, choices=(8, 16), default=8, help="per channel of the image (default: 8)"
    )
    pattern.add_argument("--format", choices=("png", "tiff"), default="png", help="(default: png)")


def _add_board(board: argparse.ArgumentParser) -> None:
    add_output_folder(board, "folder for board.pdf, .svg, .png and board.toml", required=True)
    kind = board.add_mutually_exclusive_group(required=True)
    kind.add_argument("--squares", nargs=2, type=int, metavar=("C", "R"), help="ChArUco: columns and rows")
    kind.add_argument(
        "--corners",
        nargs=2,
        type=int,
        metavar=("C", "R"),
        help="chessboard: columns and rows of inner corners",
    )
    kind.add_argument(
        "--tags", nargs=2, type=int, metavar=("C", "R"), help="Kalibr's AprilGrid: columns and rows"
    )
    kind.add_argument(
        "--target",
        dest="target_file",
        type=Path,
        metavar="FILE",
        help="board.toml, or Kalibr's target.yaml, to print",
    )
    board.add_argument("--square", type=float, metavar="MM", help="ChArUco, chessboard: edge of a square")
    board.add_argument("--tag", type=float, metavar="MM", help="AprilGrid: edge of a tag's black border")
    board.add_argument(
        "--spacing", type=float, metavar="SHARE", help="AprilGrid: gap between tags over --tag"
    )
    board.add_argument("--marker", type=float, metavar="MM", help="ChArUco: edge of a marker")
    board.add_argument("--dictionary", metavar="NAME", help="ChArUco: of the markers, as DICT_5X5_100")
    board.add_argument(
        "--first-id",
        type=int,
        default=0,
        metavar="ID",
        help="ChArUco, AprilGrid: of the first marker, for several boards",
    )
    board.add_argument("--page", help="A4 … A0, or WxH in mm (default: the smallest that holds the board)")
    board.add_argument("--dpi", type=float, default=300.0, help="resolution of board.png (default: 300)")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Generate the target."""
    from beltscape.files.atomic import ensure_output_folder

    make = _board if arguments.target == "board" else _pattern
    return make(arguments, ensure_output_folder(arguments.out), reporter)


def _pattern(arguments: argparse.Namespace, out: Path, reporter: Reporter) -> Mapping[str, Any]:
    from beltscape.files.toml_text import validate
    from beltscape.pipeline.pattern_files import write_pattern_files
    from beltscape.target.pattern import PRESETS, PatternSettings, make_pattern

    overrides = {
        "size_px": arguments.size,
        "seed": arguments.seed,
        "count": PRESETS[arguments.preset] if arguments.dots is None else arguments.dots,
        "d_min_px": arguments.d_min,
        "radius_px": arguments.radius,
        "grey": arguments.grey,
        "dot_color": arguments.dot_color,
        "background": arguments.background,
        "marker_color": arguments.marker_color,
    }
    pattern = make_pattern(validate(Path("target pattern"), PatternSettings, overrides))
    reporter.step("throwing dots", 1, 2)
    files, quality = write_pattern_files(out, pattern, bits=arguments.bits, image_format=arguments.format)
    reporter.step("drawing", 2, 2)
    return {
        "target": "pattern",
        **pattern.settings.model_dump(),
        "marker_radius_px": pattern.markers[0].radius_px,
        "nearest_min_px": quality.nearest_min_px,
        "nearest_mean_px": quality.nearest_mean_px,
        "relative_radius": quality.relative_radius,
        "low_frequency_power": quality.low_frequency_power,
        "files": files,
    }


def _board(arguments: argparse.Namespace, out: Path, reporter: Reporter) -> Mapping[str, Any]:
    from beltscape.target.print_board import lay_out, write_board_files

    board = _describe_board(arguments)
    if not 20 <= arguments.dpi <= 2400:
        raise SettingsError(f"--dpi {arguments.dpi:g}: give a resolution from 20 to 2400")
    printed = lay_out(board, arguments.page)
    files = write_board_files(out, printed, arguments.dpi)
    reporter.step("drawing", 1, 1)
    return {
        "target": "board",
        "board": printed.board.model_dump(),
        "page_mm": printed.sheet.size_mm,
        "board_origin_mm": printed.origin_mm,
        "dpi": arguments.dpi,
        "files": files,
    }


def _describe_board(arguments: argparse.Namespace) -> PlanarBoard:
    """Return the board that the options describe; SettingsError names one that is missing or has no meaning."""
    from beltscape.files.toml_text import validate
    from beltscape.target.board import AprilGrid, BoardSet, CharucoBoard, Chessboard, read_board

    first_id = arguments.first_id or None
    if arguments.target_file is not None:
        _require_options(arguments, "a board from a file", (), tuple(_LENGTHS))
        board = read_board(arguments.target_file)
        if isinstance(board, BoardSet):
            raise SettingsError(
                f"--target {arguments.target_file}: holds several boards; print one after the other"
            )
        return board
    if arguments.tags is not None:
        _require_options(arguments, "an AprilGrid", ("tag", "spacing"), ("square", "marker", "dictionary"))
        values = {"tags": arguments.tags, "tag_mm": arguments.tag, "spacing": arguments.spacing}
        return validate(Path("target board"), AprilGrid, {**values, "first_id": arguments.first_id})
    if arguments.corners is not None:
        if first_id:
            raise SettingsError(
                f"--first-id {first_id}: a chessboard has no markers; give --squares, or leave it out"
            )
        _require_options(
            arguments,
            "a chessboard",
            ("square",),
            ("marker", "dictionary", "tag", "spacing"),
        )
        values = {"corners": arguments.corners, "square_mm": arguments.square}
        return validate(Path("target board"), Chessboard, values)
    _require_options(arguments, "a ChArUco board", ("square", "marker", "dictionary"), ("tag", "spacing"))
    values = {
        "squares": arguments.squares,
        "square_mm": arguments.square,
        "marker_mm": arguments.marker,
        "dictionary": arguments.dictionary,
    }
    return validate(Path("target board"), CharucoBoard, {**values, "first_id": arguments.first_id})


def _require_options(
    arguments: argparse.Namespace, what: str, needed: Sequence[str], meaningless: Sequence[str]
) -> None:
    """Raise SettingsError for an option that is missing or has no meaning."""
    for option in needed:
        if getattr(arguments, option) is None:
            listed = " and ".join(f"--{each} {_LENGTHS[each]}" for each in needed)
            raise SettingsError(f"--{option} is missing; {what} needs {listed}")
    for option in meaningless:
        if getattr(arguments, option) is not None:
            raise SettingsError(
                f"--{option} {getattr(arguments, option)}: {what} has no {option}; leave it out"
            )


def summary(result: Mapping[str, Any]) -> str:
    """Format the result in a few lines."""
    if result["target"] == "board":
        (width, height), files = result["page_mm"], result["files"]
        return (
            f"board  {files['pdf']} on {width:g}×{height:g} mm; print at 100 %, check that the ruler is 100 mm\n"
            f"       {files['svg']}, {files['png']}\n"
            f"       {files['toml']} for beltscape calibrate"
        )
    (width, height), files = result["size_px"], result["files"]
    return (
        f"pattern {files['image']}, {result['count']} dots on {width}×{height} px\n"
        f"        radius {result['radius_px']:g} px, d_min {result['d_min_px']:g} px, "
        f"nearest neighbour {result['nearest_mean_px']:.2f} px on average\n"
        f"        {files['pattern']}, {files['svg']}\n"
        f"quality {files['picture']}: power {result['low_frequency_power']:.3f} at low frequencies (1 if independent)"
    )
