"""``beltscape check CAPTURE --rig rig.json --board board.toml``: scores a rig on new images of a board."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltscape.cli.arguments import require_positive
from beltscape.cli.terminal import format_findings
from beltscape.core.progress import Reporter

if TYPE_CHECKING:
    from beltscape.core.geometry.rig import Rig
    from beltscape.target.board import Board


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("capture", type=Path, help="folder <capture>/<camera>/<frame>.png of board views")
    parser.add_argument("--rig", type=Path, required=True, help="rig.json to check")
    parser.add_argument("--board", type=Path, required=True, help="board.toml")
    parser.add_argument(
        "--delays", type=float, metavar="MM_S",
        help="the board was carried about: measure each camera's delay, also in mm of a belt of this speed",
    )  # fmt: skip


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Score the rig."""
    from beltscape.files.rig_json import read_rig
    from beltscape.pipeline.calibrating.check import check
    from beltscape.target.board import read_board

    board, rig = read_board(arguments.board), read_rig(arguments.rig)
    require_positive("--delays", arguments.delays)
    if arguments.delays is not None:
        return _measure_delays(arguments, rig, board, reporter)
    result = check(arguments.capture, rig, board, reporter)
    return {
        "fit": result.fit.document(),
        "scale": result.scale,
        "score": result.score.document(),
        "cameras": {
            name: {frame: view.rms_px for frame, view in views.items()}
            for name, views in result.rig_errors.residuals.items()
        },
    }


def _measure_delays(
    arguments: argparse.Namespace, rig: Rig, board: Board, reporter: Reporter
) -> Mapping[str, Any]:
    from beltscape.pipeline.calibrating.trigger_delay import measure_trigger_delays

    delays = measure_trigger_delays(arguments.capture, rig, board, arguments.delays, reporter)
    return {
        "speed_mm_s": arguments.delays,
        "delays": {
            name: {
                "delay_ms": one.delay_ms,
                "sigma_ms": one.sigma_ms,
                "belt_mm": one.displacement_mm,
                "sigma_mm": one.sigma_mm,
            }
            for name, one in delays.items()
        },
    }


def _format_delays(result: Mapping[str, Any]) -> str:
    lines = [
        f"{name:<14} {one['delay_ms']:+.3f} ms ± {one['sigma_ms']:.3f} ms, {one['belt_mm']:+.3f} mm ± "
        f"{one['sigma_mm']:.3f} mm of belt"
        for name, one in result["delays"].items()
    ]
    return "\n".join([f"delays against the core, belt at {result['speed_mm_s']:g} mm/s", *lines])


def _format_lengths(score: Mapping[str, Any]) -> list[str]:
    """Return the errors of triangulated corners; one line where two cameras see none of them."""
    if not isfinite(score["square_rms_mm"]):
        return ["square edge    not measured: no two cameras see the same corner"]
    return [
        f"square edge    bias {score['square_bias_mm']:+z.4f} mm, RMS {score['square_rms_mm']:.4f} mm",
        f"planarity      RMS {score['planarity_rms_mm']:.4f} mm",
    ]


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines, findings against the rig first."""
    if "delays" in result:
        return _format_delays(result)
    s = result["score"]
    lines = [
        *format_findings(result["fit"]),
        f"{s['frames']} frames, {s['views']} views, {s['corners']} corners",
        f"reprojection   RMS {s['rms_px']:.3f} px, median {s['median_px']:.3f} px",
        *_format_lengths(s),
    ]
    for name, views in result["cameras"].items():
        if views:
            worst = max(views, key=lambda frame: views[frame])
            lines.append(f"{name:<14} {len(views)} views, worst {worst} with {views[worst]:.3f} px")
    return "\n".join(lines)
