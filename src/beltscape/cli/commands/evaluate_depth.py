"""``beltscape evaluate depth DIR --truth TRUTH_DIR|NPZ|TIFF``: compares depths of any method with the true ones."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "folder", type=Path, metavar="DIR", help="a reconstruction, a frame folder, or a depth.tiff"
    )
    parser.add_argument(
        "--truth",
        type=Path,
        required=True,
        help="truth folder of simulate, an npz file in it, or a TIFF",
    )
    parser.add_argument("--scene", help="which of a truth folder's scenes, where it has several")
    parser.add_argument(
        "--within", type=float, metavar="MM", help="compare so near to the rig along the belt (240)"
    )


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Compare every frame with its truth."""
    from beltscape.cli.arguments import require_plausible
    from beltscape.core.quantities import STRETCH
    from beltscape.evaluate.frame_scores import score_reconstruction
    from beltscape.evaluate.truth import WITHIN_MM, read_truth

    within = require_plausible("--within", arguments.within, STRETCH) or WITHIN_MM
    truth = read_truth(arguments.truth, arguments.scene)
    frames = score_reconstruction(arguments.folder, truth, reporter, within_mm=within)
    return {
        "truth": truth.path,
        "within_mm": within,
        "frames": [
            {"frame": name, "regions": {region: score.document() for region, score in regions.items()}}
            for name, regions in frames.items()
        ],
    }


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    lines = [
        f"{'frame':<8} {'region':<9} {'measured':>8} {'<1mm':>7} {'<.25mm':>7} {'gross':>7} {'median':>8} "
        f"{'bias':>8} {'robust σ':>8} {'P95':>7} {'σ ratio':>7} {'false fill':>10}"
    ]
    for frame in result["frames"]:
        lines += [f"{frame['frame']:<8} {_line(name, s)}" for name, s in frame["regions"].items()]
    return "\n".join([*lines, "lengths in mm; shares < 1 and < 0.25 mm are of all true pixels of the region"])


def _line(region: str, s: Mapping[str, Any]) -> str:
    line = (
        f"{region:<9} {s['coverage']:8.1%} {s['within_1mm']:7.1%} {s['within_quarter_mm']:7.1%} {s['gross']:7.2%} "
        f"{s['interior_median_mm']:8.4f} {s['interior_bias_mm']:+8.4f} {s['interior_robust_sigma_mm']:8.4f} "
        f"{s['interior_p95_mm']:7.3f} {s['sigma_ratio']:7.2f} {s['false_fill']:10.1%}"
    )
    return line.replace("nan%", "   –").replace("nan", "  –")
