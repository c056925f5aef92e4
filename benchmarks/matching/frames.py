"""Benchmark of whole frames: accuracy, reliability of σ, time and memory of every method on every scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from beltscape.core.errors import BeltscapeError
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.measure.belt.empty_belt import find_belt
from beltscape.measure.volume.settings import VolumeSettings
from beltscape.measure.volume.volume import measure_volume
from beltscape.stereo.multiview.depth_range import find_depth_range
from captures import FULL, LABELS, Scene, read_rendered
from matching.methods import HH, METHODS, MULTIVIEW, SGBM, Range, Result, bare_sgbm, run
from tables import format_cells, format_head
from timing import Cost, run_in_fresh_process

_COLUMNS = (
    "method", "< 1 mm", "< 0.25 mm", "median mm", "bias mm", "σ mm", "P95 mm", "gross", "measured", "false fill",
    "σ ratio", "over fifths", "locking px", "s, 2 threads", "s, 1 thread", "CPU s", "MB", "× SGBM", "× HH",
)  # fmt: skip
HH_PIXELS = 2_000_000
"""SGBM with 8 directions uses about 1.5 KB per pixel and thread; it is left out for larger images."""
NOTES = """\
Depth: shares < 1 mm and < 0.25 mm of *all* true pixels of the scene's own surface within ±240 mm along the belt;
median, bias, robust σ, P95, σ ratio, locking: pixels more than 6 px from a true step; gross: > 5 mm, of the
measured; halved images: without the pixels astride a step, whose true depth is two. False fill: share of the pixels
no auxiliary sees that carry a depth; which these are comes of the true depth of the core's view cast into the
auxiliaries, an approximation (at full size from the simulator's rays). σ ratio: actual over predicted, and its least
and greatest over fifths of the predicted σ. Locking: peak to peak of the mean error over the fraction of the
disparity of the most horizontal pair, in px of what is matched. Times are of a frame of a prepared matcher with a
known depth range; MB: what a fresh process grew by. × SGBM, × HH: time over that of one bare OpenCV SGBM call per
pair (5 directions, or all 8) on the same images in the same run, both with two threads, of which SGBM gives
each its own pair."""


def head(*more: str) -> list[str]:
    return format_head((*more, *_COLUMNS))


def row(name: str, result: Result, bases: Sequence[Cost | None], *more: str) -> str:
    """Return a table row with a method's scores and, if measured, its cost."""
    s = result.score
    low, high = result.sigma_ratios
    cells = [
        *more, name, f"{s.within_1mm:.2%}", f"{s.within_quarter_mm:.2%}", f"{s.interior_median_mm:.4f}",
        f"{s.interior_bias_mm:+.4f}", f"{s.interior_robust_sigma_mm:.4f}", f"{s.interior_p95_mm:.3f}",
        f"{s.gross:.2%}", f"{s.coverage:.2%}", _share(result.false_fill), f"{s.sigma_ratio:.2f}",
        f"{low:.2f}–{high:.2f}", f"{result.locking_px:.4f}", *_cost_cells(result.cost, bases),
    ]  # fmt: skip
    return format_cells(["" if cell == "nan" else cell for cell in cells])


def _share(value: float) -> str:
    return "none unseen" if np.isnan(value) else f"{value:.1%}"


def _cost_cells(spent: Cost | None, bases: Sequence[Cost | None]) -> list[str]:
    if spent is None:
        return [""] * (4 + len(SGBM))
    times = [f"{spent.wall_s[threads]:.2f}" for threads in (2, 1)]
    ratios = [f"{spent.wall_s[2] / base.wall_s[2]:.2f}" if base else "" for base in bases]
    return [*times, f"{spent.cpu_s:.2f}", f"{spent.peak_mb:.0f}", *ratios]


def frames(scenes: list[Scene], full: Scene | None, calibrated: Rig | None) -> Iterator[list[str]]:
    """Yield a table per scene, with a row for the measured calibration, and finally one of volumes."""
    yield [NOTES, ""]
    results: dict[tuple[str, str], Mapping[str, Result]] = {}
    for scene in scenes:
        lines, results[scene.name, scene.size] = _scene(scene, calibrated)
        yield lines
    if full is not None:
        yield _scene(full, None)[0]
    else:
        yield [
            f"2448×2048: left out. {FULL}=1 simulates a capture of that size once, which takes minutes.",
            "",
        ]
    yield _volumes(scenes, results)


def _scene(scene: Scene, calibrated: Rig | None) -> tuple[list[str], Mapping[str, Result]]:
    near_far = find_depth_range(scene.rig, scene.frame, Silent())
    lines = [f"### {scene.name}, {scene.size}, {near_far[0]:.0f} … {near_far[1]:.0f} mm", "", *head()]
    bare = [name for name in SGBM if name != HH or scene.true_depth_mm.size <= HH_PIXELS]
    costs = {name: run_in_fresh_process(bare_sgbm, name, scene, near_far) for name in bare}
    bases = [costs.get(name) for name in SGBM]
    results: dict[str, Result] = {}
    for method in METHODS:
        try:
            results[method] = run_in_fresh_process(run, method, scene, near_far)
        except BeltscapeError as error:
            lines.append(f"| {_name(method)} | {error} |" + " |" * (len(_COLUMNS) - 2))
        else:
            lines.append(row(_name(method), results[method], bases))
    if calibrated is not None and "standard" in results:
        lines.append(_own_calibration(scene, calibrated, near_far))
    empty = " |" * (len(_COLUMNS) - 5 - len(SGBM))
    lines += [f"| bare {name} |{empty} {' | '.join(_cost_cells(c, bases))} |" for name, c in costs.items()]
    return [*lines, ""], results


def _own_calibration(scene: Scene, calibrated: Rig, near_far: Range) -> str:
    result = run("standard", scene.with_rig(calibrated), near_far, timed=False)
    return row("multiview standard, own calibration", result, ())


def _name(method: str) -> str:
    return f"multiview {method}" if method in MULTIVIEW else method


def _volumes(scenes: list[Scene], results: Mapping[tuple[str, str], Mapping[str, Result]]) -> list[str]:
    rows = [
        "### Volumes",
        "",
        "| volume | size | method | measured l | σ l | true l | error | coverage |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for scene in scenes:
        for method in ("standard", "pairwise"):
            loaded = results[scene.name, scene.size].get(method)
            empty = results["belt_empty", scene.size].get(method)
            if scene.true_volume_mm3 is None or loaded is None or empty is None:
                continue
            camera = scene.rig.core_camera
            v = measure_volume(
                loaded.depth, find_belt(empty.depth, camera), camera, VolumeSettings(),
                across_mm=None, along_mm=scene.along_mm,
            )  # fmt: skip
            rows.append(
                f"| {scene.name} | {scene.size} | {_name(method)} | {v.volume_mm3 / 1e6:.3f} | "
                f"{v.sigma_mm3 / 1e6:.3f} | {scene.true_volume_mm3 / 1e6:.3f} | "
                f"{v.volume_mm3 / scene.true_volume_mm3 - 1:+.2%} | {v.coverage:.1%} |"
            )
    return rows


def without_speckle(folder: Path) -> list[str]:
    """Return the table of captures without speckle, by the standard preset."""
    lines = [
        "| no speckle | size | measured | < 1 mm | < 0.25 mm | gross | false fill |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in LABELS:
        capture = f"{name}_nospeckle"
        if not (folder / capture).is_dir():
            continue
        for halvings in (1, 0):
            lit = read_rendered(folder, name, halvings)
            # the depth range is taken from the capture with speckle, because an empty belt does not show one without
            near_far = find_depth_range(lit.rig, lit.frame, Silent())
            result = run("standard", read_rendered(folder, name, halvings, capture), near_far, timed=False)
            s = result.score
            lines.append(
                f"| {name} | {lit.size} | {s.coverage:.2%} | {s.within_1mm:.2%} | {s.within_quarter_mm:.2%} | "
                f"{s.gross:.2%} | {_share(result.false_fill)} |"
            )
    return lines
