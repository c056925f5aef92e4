"""Benchmark of the matchers on real stereo pairs; prints tables.

    cd benchmarks && python -m matching.real_pairs [REAL]

REAL is a folder with the pairs of `stereo_pairs.read_pairs` (default: ../shared/data/real beside the
repository); missing pairs are listed and left out.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.errors import BeltscapeError
from beltscape.evaluate.depth_scores import compute_robust_sigma
from stereo_pairs.disparity_pair import DisparityPair
from stereo_pairs.read_pairs import METHODS, read_dice_auto, read_dice_gt4, read_motorcycle
from stereo_pairs.speckle_pair import SpecklePair

PAIRS = {
    "dice_gt4_speckle": read_dice_gt4,
    "dice_stereo_auto": read_dice_auto,
    "middlebury_motorcycle": read_motorcycle,
}
SUBSETS_PX = (1, 9, 25)


def real_pairs(folder: Path) -> list[str]:
    """Return two Markdown tables: differences from correspondences, and errors of disparity."""
    pairs = [read(folder / name) for name, read in PAIRS.items() if (folder / name).is_dir()]
    points = [
        "| real pair | method | depth over | points | measured | median px | robust σ px | P95 px | > 1 px | s |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    shares = [
        "| real pair | method | of | pixels | measured | < 0.5 px | < 1 px | < 2 px | median px | > 4 px | s |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    notes = []
    for pair in pairs:
        if isinstance(pair, SpecklePair):
            points += _correspondence_rows(pair)
            epipolar = pair.epipolar_px()
            notes.append(
                f"{pair.name}: distance of the reference from its epipolar lines "
                f"{np.median(epipolar):+.3f} px (median), "
                f"robust σ {compute_robust_sigma(epipolar):.3f} px, P95 {np.percentile(np.abs(epipolar), 95):.3f} px."
            )
        else:
            shares += _disparity_rows(pair)
    notes += [f"{name}: not available." for name in PAIRS if not (folder / name).is_dir()]
    return [*points, "", *shares, "", *notes]


def _method_rows(
    pair: SpecklePair | DisparityPair, make_rows: Callable[[DepthMap], list[str]], empty_cells: int
) -> list[str]:
    """Return the rows of every method: its name, the cells of ``make_rows`` and the seconds it took."""
    rows = []
    for method, reconstruct in METHODS.items():
        start = time.perf_counter()
        try:
            depth = reconstruct(pair.rig, pair.frame_set, pair.depth_range_mm)
        except BeltscapeError as error:
            rows.append(f"| {pair.name} | {method} | {error} |" + " |" * empty_cells)
            continue
        took = time.perf_counter() - start
        rows += [f"| {pair.name} | {method} | {cells} | {took:.2f} |" for cells in make_rows(depth)]
    return rows


def _correspondence_rows(pair: SpecklePair) -> list[str]:
    def make_rows(depth: DepthMap) -> list[str]:
        compared = [(edge, pair.compare(depth, subset_px=edge)) for edge in SUBSETS_PX]
        return [
            f"{edge}×{edge} px | {a.points} | {a.measured:.1%} | "
            f"{a.median_px:+.4f} | {a.robust_sigma_px:.4f} | {a.p95_px:.3f} | {a.gross:.2%}"
            for edge, a in compared
        ]

    return _method_rows(pair, make_rows, empty_cells=7)


def _disparity_rows(pair: DisparityPair) -> list[str]:
    def make_rows(depth: DepthMap) -> list[str]:
        regions = (("all", None), ("seen by both", pair.covisible_mask()))
        scored = [(label, pair.score(depth, region)) for label, region in regions]
        return [
            f"{label} | {s.pixels} | {s.coverage:.1%} | {s.within_half_px:.1%} | "
            f"{s.within_1px:.1%} | {s.within_2px:.1%} | {s.median_px:.3f} | {s.gross:.2%}"
            for label, s in scored
        ]

    return _method_rows(pair, make_rows, empty_cells=8)


if __name__ == "__main__":
    default = Path(__file__).parents[3] / "shared" / "data" / "real"
    print("\n".join(real_pairs(Path(sys.argv[1]) if len(sys.argv) > 1 else default)))
