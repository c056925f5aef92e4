"""``beltscape evaluate belt FLOW --truth TRUTH_DIR``: compares a fused belt with the simulated heap."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("flow", type=Path, metavar="FLOW", help="the --out folder of measure flow")
    parser.add_argument(
        "--truth", type=Path, required=True, help="truth folder of simulate, of a moving belt"
    )


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Compare the fused belt's loaded cells with their true heights."""
    from beltscape.evaluate.belt_ceiling import MovingCeiling, read_moving_scene
    from beltscape.evaluate.belt_scores import CELL_MM, read_true_belt, score_belt
    from beltscape.files.fused_belt import read_fused_belt

    fused = read_fused_belt(arguments.flow).coarsen(CELL_MM)
    truth, scene = read_true_belt(arguments.truth), read_moving_scene(arguments.truth)
    score = score_belt(fused, truth, None if scene is None else MovingCeiling(scene))
    reporter.step("comparing the belt", 1, 1)
    return {
        "flow": arguments.flow,
        "truth": arguments.truth,
        "cell_mm": fused.heights.cell_mm,
        **score.document(),
    }


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    s = result
    text = "\n".join((
        f"loaded   {s['cells']} cells of {s['cell_mm']:.1f} mm, {s['measured']:.1%} measured by some frame, the "
        "others filled",
        f"error    {s['within_1mm']:.1%} within 1 mm, {s['within_2mm']:.1%} within 2 mm, {s['gross']:.2%} above 5 mm"
        f"; of the measured {s['measured_gross']:.2%}, median {s['median_mm']:.2f} mm",
        f"ceiling  {s['visible']:.1%} visible and lit in some frame; of these {s['visible_measured']:.1%} measured, "
        f"{s['visible_within_1mm']:.1%} within 1 mm, {s['visible_gross']:.2%} above 5 mm",
        f"level    {1 - s['steps']:.1%} without a step above 10 mm; of these {s['level_within_1mm']:.1%} within 1 mm"
        f", {s['level_gross']:.2%} above 5 mm",
        f"bias     {s['bias_mm']:+.3f} mm of all, {s['filled_bias_mm']:+.2f} mm of the filled",
        f"σ ratio  {s['sigma_ratio_low']:.2f} to {s['sigma_ratio_high']:.2f} over the fifths of predicted σ",
    ))  # fmt: skip
    return text.replace("+nan mm", "–").replace("nan%", "–").replace("nan", "–")
