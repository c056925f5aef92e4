"""All benchmarks of accuracy and speed, relative to OpenCV in the same run; writes RESULTS.md.

    python benchmarks/run.py [RENDERED] [--only SECTION ...]

RENDERED is a folder of rendered captures with truth (default: ../shared/data/rendered beside the repository);
without one the capture that ships with the demo is used. ``--only`` measures some sections and keeps the others, each
with its own commit. BELTSCAPE_BENCH_FULL=1 adds a capture at the sensor's full size, which is simulated once, in
minutes, into out/bench-captures.
"""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Callable
from functools import cached_property
from pathlib import Path

import cv2

from axes import other_plants
from beltscape.core.geometry.rig import Rig
from beltscape.kernels.native import levels
from calibration import calibration as benchmark_calibration
from captures import Scene, demo_scenes, full_size_scene, rendered_scenes
from cluster.scaling import cluster_scaling
from live import live
from matching import frames, kernels
from matching.choices import choices
from matching.real_pairs import real_pairs
from matching.robustness import NOTES as ROBUSTNESS_NOTES
from matching.robustness import SCENES, robustness
from matching.triangulation import triangulation
from protocols.load import protocols_load
from realtime import realtime
from results import load_average, make_section, write_results

HERE = Path(__file__).parent


class Benchmarks:
    """The sections of RESULTS.md by title, and the captures they share."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.sections: dict[str, Callable[[], list[str]]] = {
            "Calibration": lambda: self.calibration[0],
            "Whole frames": self.whole_frames,
            "Choices": lambda: (
                choices(self.folder) if self.folder.is_dir() else ["Left out: no rendered captures."]
            ),
            "Running system": lambda: live(self.folder, self.scenes[0].rig),
            "Other plants": other_plants,
            "Real time": lambda: realtime(self.folder, self.scenes[0].rig),
            "Protocols": protocols_load,
            "Re-processing": cluster_scaling,
            "Without speckle": lambda: frames.without_speckle(self.folder),
            "Spoiled frames": self.degraded_frames,
            "Real pairs": lambda: real_pairs(self.folder.parent / "real"),
            "Kernels": self.kernels,
        }

    @cached_property
    def scenes(self) -> list[Scene]:
        """Scenes with exact rigs."""
        return rendered_scenes(self.folder) if self.folder.is_dir() else demo_scenes()

    @cached_property
    def calibration(self) -> tuple[list[str], Rig | None]:
        """The calibration's tables and the calibrated rig."""
        return benchmark_calibration(self.folder)

    def whole_frames(self) -> list[str]:
        """Return the tables of whole frames by scene and size."""
        full = full_size_scene(HERE.parent / "out" / "bench-captures")
        return [line for part in frames.frames(self.scenes, full, self.calibration[1]) for line in part]

    def degraded_frames(self) -> list[str]:
        """Return the table of frames with image faults, at the smallest size."""
        small = min(scene.true_depth_mm.size for scene in self.scenes)
        scenes = [s for s in self.scenes if s.name in SCENES and s.true_depth_mm.size == small]
        return [ROBUSTNESS_NOTES, "", *robustness(scenes)]

    def kernels(self) -> list[str]:
        """Return the tables of single kernels compared with OpenCV."""
        modules = [scene for scene in self.scenes if scene.name == "module"]
        return [kernels.NOTES, "", *kernels.kernels(modules), "", *triangulation()]


def main() -> None:
    """Measure the chosen sections, print them, and write RESULTS.md after each."""
    arguments = _arguments()
    benchmarks = Benchmarks(arguments.rendered)
    order = list(benchmarks.sections)
    head = (
        f"Written by `make bench` on {os.cpu_count()} cores ({platform.machine()}), "
        f"OpenCV {cv2.__version__}. At a load average above 0.5 before a section, its wall times and what two "
        "threads gain say little; its CPU seconds say more. Rigs are exact where nothing else is stated."
    )
    for title in arguments.only or order:
        load = load_average()
        section = make_section(title, benchmarks.sections[title](), levels()[-1], load)
        print("\n".join([f"## {title}", "", *section.lines, ""]), flush=True)
        write_results(HERE / "RESULTS.md", head, [section], order)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    default = HERE.parents[1] / "shared" / "data" / "rendered"
    parser.add_argument("rendered", nargs="?", type=Path, default=default, help="captures with truth")
    parser.add_argument(
        "--only", nargs="+", metavar="SECTION", choices=list(Benchmarks(default).sections), help="sections"
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
