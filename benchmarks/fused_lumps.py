"""The lumps of moving heaps against the rocks on top: single frames, all frames summed, and the fused belt.

    python benchmarks/fused_lumps.py CACHE [--heaps NAME …] [--preset fast|standard]

The heaps are those of fused_belt.py, rendered once into CACHE. A row has the lumps counted, the visible rocks, the
shares of rocks found and of false lumps, d10, d50, d80, d90 with those of the rocks, and their errors over their σ.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from beltscape.evaluate.belt_lump_scores import read_rocks, score_belt_lumps
from beltscape.evaluate.lump_scores import LumpScore, find_covered_rows, read_heap, score_lumps
from beltscape.measure.belt.reference import EmptyBeltReference
from beltscape.measure.lumps.fused_belt import measure_belt_lumps
from beltscape.measure.lumps.lumps import SHARES, Lumps, compute_passing_sizes, measure_lumps
from beltscape.measure.lumps.settings import LumpSettings
from fused_belt import HEAPS, Pushed, match_heap, measure
from tables import format_cells, format_head

_HEAD = (
    "heap",
    "surface",
    "lumps",
    "rocks",
    "found",
    "false",
    "d10–d90 mm",
    "true d10–d90 mm",
    "errors in σ",
    "size bias, σ ratio",
)
_COARSE_MM = 4.0
"""Cell of belt.tiff of a belt of 200 m."""
_SETTINGS = LumpSettings()


def score_frames(
    reference: EmptyBeltReference, frames: Sequence[Pushed], truth: Path
) -> list[tuple[Lumps, LumpScore]]:
    """Return the lumps and scores of each frame with visible rocks."""
    scored: list[tuple[Lumps, LumpScore]] = []
    for one in frames:
        if one.depth is None:
            continue
        heap = read_heap(truth, one.name)
        lumps = measure_lumps(one.depth, reference.camera, _SETTINGS, reference.belt)
        score = score_lumps(
            lumps, heap.rock, heap.size_mm, heap.volume_mm3,
            pixel_mm=heap.pixel_mm, region=find_covered_rows(one.depth), measured=one.depth.measured,
        )  # fmt: skip
        if score.rocks:
            scored.append((lumps, score))
    return scored


def make_rows(name: str, folder: Path, preset: str) -> list[str]:
    """Return the table's rows of one heap."""
    belt, true = match_heap(name, folder, preset), folder / "moving" / "truth"
    size_mm, volume_mm3 = read_rocks(true)
    rows: list[str] = []
    scores: list[LumpScore] = []
    for surface, cell_mm in (("fused, 4 mm", _COARSE_MM), ("fused, 1 px", belt.reference.cell_mm)):
        _, fused = measure(belt.reference, belt.frames, belt.settings, cell_mm)
        lumps = measure_belt_lumps(fused.heights, fused.measured, _SETTINGS, fused.counted_mm)
        scores.append(score_belt_lumps(lumps, fused, belt.truth, size_mm, volume_mm3))
        rows.append(_format_row(name, surface, len(lumps.lumps), scores[-1]))
    scored = score_frames(belt.reference, belt.frames, true)
    middle = max(scored, key=lambda pair: pair[1].rocks)
    rows.insert(0, _format_row(name, "fullest frame", len(middle[0].lumps), middle[1]))
    uncut = [lump for lumps, _ in scored for lump in lumps.lumps if not lump.cut]
    mass = np.array([lump.volume_mm3 for lump in uncut])
    d_mm = compute_passing_sizes(np.array([lump.size_mm for lump in uncut]), mass, SHARES)
    counts = np.array([score.rocks for _, score in scored])
    found, right = (
        float(np.average([getattr(score, field) for _, score in scored], weights=counts))
        for field in ("recall", "precision")
    )
    total = sum(len(lumps.lumps) for lumps, _ in scored)
    shares = [f"{found:.0%}", f"{1 - right:.0%}"]
    sizes = [_format_sizes(tuple(d_mm)), _format_sizes(scores[-1].d_top_mm)]
    rows.insert(
        1, format_cells([name, "all frames summed", str(total), str(counts.sum()), *shares, *sizes, "", ""])
    )
    return rows


def _format_row(name: str, surface: str, count: int, score: LumpScore) -> str:
    shares = [f"{score.recall:.0%}", f"{1 - score.precision:.0%}"]
    sizes = [_format_sizes(score.d_mm), _format_sizes(score.d_top_mm)]
    errors = (np.array(score.d_mm) - score.d_top_mm) / score.d_sigma_mm
    sizes.append(", ".join(f"{error:+.1f}" for error in errors))
    ends = f"{score.size_bias:+.1%}, {score.sigma_ratio:.2f}"
    return format_cells([name, surface, str(count), str(score.rocks), *shares, *sizes, ends])


def _format_sizes(sizes_mm: tuple[float, ...]) -> str:
    return ", ".join(f"{size:.1f}" for size in sizes_mm)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cache", type=Path)
    parser.add_argument("--heaps", nargs="*", default=list(HEAPS), choices=list(HEAPS))
    parser.add_argument("--preset", default="fast", choices=["fast", "standard"])
    arguments = parser.parse_args()
    print("\n".join(format_head(_HEAD)))
    for name in arguments.heaps:
        print("\n".join(make_rows(name, arguments.cache / name, arguments.preset)), flush=True)


if __name__ == "__main__":
    main()
