"""Score lumps on simulated captures: as the truth has them (the ceiling of what depth tells), or as matched.

    python tools/score_lumps.py CAPTURE[,FRAME]…

Each CAPTURE is what ``beltscape simulate`` wrote of a loaded belt; FRAME is its frame by ``beltscape reconstruct``.
Of a matched frame the rows are compared that the matcher reached: more than half as full as they are in the middle.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from beltscape.evaluate.lumps import score_lumps, true_depth, true_rocks, true_sizes
from beltscape.files.reconstruction import read_frame
from beltscape.files.rig_json import read_rig
from beltscape.measure.lumps.lumps import measure_lumps
from beltscape.measure.lumps.settings import LumpSettings


def score(capture: Path, frame: Path | None) -> str:
    """One capture in a few lines."""
    camera = read_rig(capture / "truth" / "rig.json").core_camera
    path = next((capture / "truth").glob("*_depth.npz"))
    truth, rock = true_depth(path), true_rocks(path)
    sizes, volumes = true_sizes(path.with_name(path.name.replace("_depth", "_rocks")))
    depth = truth if frame is None else read_frame(frame).depth
    full = depth.measured.mean(axis=1)
    rows = np.flatnonzero(full > 0.5 * np.median(full))
    region = np.zeros(rock.shape, bool)
    region[rows[0] : rows[-1] + 1] = True
    start = time.perf_counter()
    found = measure_lumps(depth, camera, LumpSettings())
    seconds = time.perf_counter() - start
    pixel_mm = float(np.median(truth.depth_mm[rock >= 0])) / float(camera.focal_px.mean())
    one = score_lumps(found, rock, sizes, volumes, pixel_mm=pixel_mm, region=region, measured=depth.measured)
    return "\n".join(
        (
            f"  visible {one.rocks}, found {one.recall:.2f}; measured {one.rocks_measured}, found "
            f"{one.recall_measured:.2f}; precision {one.precision:.2f}, IoU {one.iou:.2f}; {seconds:.1f} s",
            f"  over 60 mm: {one.rocks_over} rocks, found {one.recall_over:.2f}; {one.lumps_over} lumps, precision "
            f"{one.precision_over:.2f}; by size {one.alarm_recall:.2f} and {one.alarm_precision:.2f}",
            f"  size of {one.sized} whole lumps: bias {one.size_bias:+.1%}, median |error| {one.size_error:.1%}, "
            f"IQR {one.size_iqr:.1%}, σ ratio {one.sigma_ratio:.2f}",
            f"  size of {one.all_sized} lumps: bias {one.all_bias:+.1%}, median |error| {one.all_error:.1%}",
            f"  d50 {one.d50_mm:.1f} mm; true of the top layer {one.d50_top_mm:.1f} mm, of the heap "
            f"{one.d50_heap_mm:.1f} mm",
        )
    )


def main(*captures: str) -> None:
    """A few lines for each."""
    for capture in captures:
        folder, _, frame = capture.partition(",")
        print(f"{capture}\n{score(Path(folder), Path(frame) if frame else None)}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
