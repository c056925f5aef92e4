"""Where the claims hold on a moving belt: the flow over plants that differ in cameras, pattern and material.

    python benchmarks/axes_flow.py [--scenes TEXT …] [--presets NAME …] [--cache FOLDER]

The scenes are those of axes.py, whose heap passes at 1 m/s; nothing was fitted to them. Each is rendered once (some
minutes). The rig is exact; the empty belt is learned from a frame of its own. The columns:

measured   share of the belt that is measured, the mean over the strips
volume     error of the total, its σ, and the error in σ
strips     strips with a full record, of all
"""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import fused_belt
from axes import PRESETS, SCENES, merge_tables
from beltscape.files.json_text import read_json
from beltscape.simulate.scenario import Scenario
from matching.scenes import ROOT
from tables import format_cells, format_head

CACHE = ROOT / "out" / "bench-axes-flow"
"""Folder of the rendered belts."""
_CHOSEN = ["plant: four", "auxiliaries: two in an L", "stranger: slabs and rods", "stranger: glossy pellets"]
_MOTION = {"speed_mm_s": 1000.0, "frames_per_s": 5.0}
_SEEDS = {"belt_empty": 500, "belt_moving": 7}
"""Added to a scene's seed, so that its noise is another one."""
_HEAD = ("preset", "scene", "measured", "volume", "strips")


def render(name: str, cache: Path) -> Path:
    """Return the folder of a scene's moving belt and empty belt, rendered where they are not there yet."""
    tables = tomllib.loads(SCENES.read_text("utf-8"))
    changes = tables["scenes"][name]
    plant = tables["plants"][changes.pop("plant", "paper")]
    folder = cache / name.replace(": ", "_").replace(" ", "_")

    def make_scenario(kind: str) -> Scenario:
        table = merge_tables(plant, changes) | {"kind": kind, "seed": plant["seed"] + _SEEDS[kind]}
        return Scenario.model_validate(
            table | ({"frames": 1} if kind == "belt_empty" else {"motion": _MOTION})
        )

    fused_belt.render(folder, make_scenario)
    return folder


def measure(name: str, folder: Path, preset: str) -> str:
    """Return the row of a scene and a preset."""
    true_mm3 = read_json(folder / "moving" / "truth" / "belt_moving.json")["heap_volume_mm3"]
    flow = fused_belt.measure_flow(folder, preset)
    totals, strips = flow.meter.totals, flow.records
    error, sigma = totals.volume_mm3 / true_mm3 - 1, totals.sigma_mm3 / true_mm3
    full = sum(strip.quality == "measured" for strip in strips)
    return format_cells([
        preset, name, f"{np.mean([strip.coverage for strip in strips]):.0%}",
        f"{error:+.2%} ± {sigma:.2%} ({error / sigma:+.1f} σ)", f"{full} of {len(strips)}",
    ])  # fmt: skip


def play(names: list[str], presets: list[str], cache: Path) -> Iterator[str]:
    """Yield the rows of the chosen scenes and presets."""
    scenes = tomllib.loads(SCENES.read_text("utf-8"))["scenes"]
    for name in [name for name in scenes if any(text in name for text in names)]:
        folder = render(name, cache)
        for preset in presets:
            yield measure(name, folder, preset)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", nargs="+", default=_CHOSEN)
    parser.add_argument("--presets", nargs="+", default=PRESETS)
    parser.add_argument("--cache", type=Path, default=CACHE)
    chosen = parser.parse_args()
    print("\n".join(format_head(_HEAD)))
    for row in play(chosen.scenes, chosen.presets, chosen.cache):
        print(row, flush=True)


if __name__ == "__main__":
    main()
