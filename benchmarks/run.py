"""Accuracy and speed beside each other, as ratios against OpenCV in the same run; writes RESULTS.md.

    python benchmarks/run.py [RENDERED]

RENDERED is a folder of rendered captures with truth (default: ../shared/data/rendered beside the repository);
without one the capture that ships with the demo is used. BELTSCAPE_BENCH_FULL=1 adds a capture at the sensor's full
size, which is simulated once, in minutes, into out/bench-captures.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2

import frames
import kernels
from beltscape.kernels.native import levels
from calibration import calibration
from captures import demo_scenes, full_size, rendered_scenes
from live import live
from real import real_pairs
from robustness import NOTES as ROBUSTNESS_NOTES
from robustness import SCENES, robustness

HERE = Path(__file__).parent


def main() -> None:
    """Run everything, tell of it section by section, and write RESULTS.md."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE.parents[1] / "shared" / "data" / "rendered"
    lines: list[str] = []
    for section in sections(folder):
        print("\n".join(section), flush=True)
        lines += section
    (HERE / "RESULTS.md").write_text("\n".join(lines), encoding="utf-8")


def sections(folder: Path) -> Iterator[list[str]]:
    """Parts of RESULTS.md, each of which takes a while."""
    scenes = rendered_scenes(folder) if folder.is_dir() else demo_scenes()
    small = min(scene.true_depth_mm.size for scene in scenes)
    spoiled = [s for s in scenes if s.name in SCENES and s.true_depth_mm.size == small]
    yield [
        "# Results",
        "",
        f"`make bench` on {os.cpu_count()} cores ({platform.machine()}, kernels {levels()[-1]}), "
        f"OpenCV {cv2.__version__}. Load average before: {os.getloadavg()[0]:.1f}; above 0.5, wall times and what "
        "two threads gain say little, and CPU s more. Rigs exact where nothing else is said.",
        "",
    ]
    rig_lines, found = calibration(folder)
    yield _section("Calibration", rig_lines)
    full = full_size(HERE.parent / "out" / "bench-captures")
    yield _section("Whole frames", [])
    yield from frames.frames(scenes, full, found)
    yield [""]
    yield _section("Running system", live(folder, scenes[0].rig))
    yield _section("Without speckle", frames.without_speckle(folder))
    yield _section("Spoiled frames", [ROBUSTNESS_NOTES, "", *robustness(spoiled)])
    yield _section("Real pairs", real_pairs(folder.parent / "real"))
    modules = [scene for scene in scenes if scene.name == "module"]
    yield _section("Kernels", [kernels.NOTES, "", *kernels.kernels(modules), "", *kernels.triangulation()])


def _section(title: str, lines: list[str]) -> list[str]:
    return [f"## {title}", "", *lines, ""]


if __name__ == "__main__":
    main()
