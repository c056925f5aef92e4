"""``beltscape evaluate lumps --truth TRUTH_DIR [DIR/<frame>]``: compares lumps with the simulated rocks."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from beltscape.core.progress import Reporter

OVER_MM = 60.0
"""Default of ``--over``, as in `score_lumps`."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "frame", type=Path, nargs="?", metavar="DIR/<frame>|FLOW",
        help="frame folder of a reconstruction, or folder of beltscape measure flow (left out: lumps by the true "
        "depth of a still belt, the most that depth can tell)",
    )  # fmt: skip
    parser.add_argument(
        "--truth",
        type=Path,
        required=True,
        help="truth folder of simulate, of a loaded or moving belt with rocks",
    )
    parser.add_argument(
        "--over", type=float, default=OVER_MM, metavar="MM", help=f"what counts as large ({OVER_MM:g})"
    )


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Compare the lumps of one frame or of a fused belt with the visible rocks."""
    from beltscape.cli.arguments import require_plausible
    from beltscape.core.quantities import LUMP
    from beltscape.evaluate.belt_lump_scores import score_lumps_of_flow
    from beltscape.evaluate.lump_scores import read_heap, score_lumps_of_frame
    from beltscape.files.fused_belt import holds_fused_belt
    from beltscape.measure.lumps.settings import LumpSettings

    over = require_plausible("--over", arguments.over, LUMP) or OVER_MM
    frame = arguments.frame
    if frame is not None and holds_fused_belt(frame):
        score = score_lumps_of_flow(frame, arguments.truth, LumpSettings(), over)
    else:
        heap = read_heap(arguments.truth, None if frame is None else frame.name)
        score = score_lumps_of_frame(heap, frame, LumpSettings(), over)
    reporter.step("comparing lumps", 1, 1)
    return {"truth": arguments.truth, "frame": frame, "over_mm": over, **asdict(score)}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    s = result
    text = "\n".join((
        f"rocks    {s['rocks']} visible, {s['recall']:.0%} found; {s['rocks_measured']} measured, "
        f"{s['recall_measured']:.0%} found; precision {s['precision']:.0%}, IoU {s['iou']:.2f}",
        f"> {s['over_mm']:g} mm  {s['rocks_over']} rocks, {s['recall_over']:.0%} found; {s['lumps_over']} lumps, "
        f"precision {s['precision_over']:.0%}; by size {s['alarm_recall']:.0%} and {s['alarm_precision']:.0%}",
        f"size     of {s['sized']} whole lumps: bias {s['size_bias']:+.1%}, median error {s['size_error']:.1%}, "
        f"IQR {s['size_iqr']:.1%}, σ ratio {s['sigma_ratio']:.2f}",
        f"         of {s['all_sized']} lumps: bias {s['all_bias']:+.1%}, median error {s['all_error']:.1%}",
        f"d10–d90  {_format(s['d_mm'])} mm; truly {_format(s['d_top_mm'])} mm in the top layer; d50 of the heap "
        f"{s['d50_heap_mm']:.1f} mm",
    ))  # fmt: skip
    return text.replace("+nan%", "–").replace("nan%", "–").replace("nan", "–")


def _format(sizes_mm: Sequence[float]) -> str:
    return ", ".join(f"{size:.1f}" for size in sizes_mm)
