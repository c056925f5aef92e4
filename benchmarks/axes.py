"""Where the claims hold: accuracy, σ and volume as one property of the plant after another changes.

    python benchmarks/axes.py [--scenes TEXT …] [--presets NAME …] [--least-confidence P]
                              [--cache FOLDER] [--out FILE]

The scenes (matching/axes.toml) differ from one plant in one respect each, and were used for no fit. They are
rendered once (a minute each). With --least-confidence the presets reject what is less probable than that. With the
exact rig and the exact empty belt every row shows the matcher and the filling of holes alone. The columns:

< 1 mm       share of all true pixels of the material or the module that are measured within 1 mm
in reach     share of them that the projector lights and an auxiliary sees
gross        share of the measured ones that are off by more than 5 mm
σ ratio      actual over predicted σ away from steps, the least and the greatest of fifths by predicted σ
invented     of the pixels that no auxiliary sees lit, those that carry a depth off by more than 5 mm
volume       error of the load's volume, its σ, and the error in σ
"""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.progress import Silent
from beltscape.evaluate.depth_scores import GROSS_MM, score_depth
from beltscape.evaluate.frame_scores import compute_sigma_ratios
from beltscape.simulate.scenario import Scenario
from beltscape.stereo.multiview.depth_range import find_depth_range
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings
from matching.methods import find_interior_errors
from matching.scenes import ROOT, AblationScene, measure_load, read_own
from tables import format_cells, format_head

SCENES = Path(__file__).parent / "matching" / "axes.toml"
CACHE = ROOT / "out" / "bench-axes"
"""Folder of the rendered scenes."""
PRESETS = ["standard", "fast"]
HEAD = ("preset", "scene", "< 1 mm", "in reach", "gross", "σ ratio in fifths", "invented", "volume")


@dataclass(frozen=True)
class Figures:
    """The figures of a preset on a scene."""

    within_1mm: float
    in_reach: float
    gross: float
    sigma_low: float
    sigma_high: float
    invented: float
    volume_error: float
    """Relative to the true volume; NaN without a load."""
    volume_sigma: float
    """Relative to the true volume."""

    def format(self, preset: str, name: str) -> str:
        """Return the row of the table."""
        volume = (
            f"{self.volume_error:+.2%} ± {self.volume_sigma:.2%} ({self.volume_error / self.volume_sigma:+.1f} σ)"
            if np.isfinite(self.volume_error)
            else ""
        )
        cells = (
            preset, name, f"{self.within_1mm:.1%}", f"{self.in_reach:.1%}", f"{self.gross:.2%}",
            f"{self.sigma_low:.2f}–{self.sigma_high:.2f}" if np.isfinite(self.sigma_low) else "–",
            f"{self.invented:.1%}", volume,
        )  # fmt: skip
        return format_cells(cells)


def list_scenarios() -> dict[str, Scenario]:
    """Return the scenarios by name."""
    tables = tomllib.loads(SCENES.read_text("utf-8"))
    return {
        name: Scenario.model_validate(merge_tables(tables["plants"][changes.pop("plant", "paper")], changes))
        for name, changes in tables["scenes"].items()
    }


def merge_tables(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table with changes; a table within it is changed, and any other value replaced."""
    both = {
        key: merge_tables(table[key], value)
        for key, value in changes.items()
        if isinstance(table.get(key), dict)
    }
    return {**table, **changes, **both}


def measure(one: AblationScene, settings: MultiviewSettings) -> Figures | None:
    """Return the figures of settings on a scene; None where no surface is found."""
    scene = one.scene
    assert one.visibility is not None
    try:
        near_far = find_depth_range(scene.rig, scene.frame, Silent())
    except ReconstructionError:
        return None
    matcher = MultiviewReconstructor(scene.rig, near_far, settings)
    depth = matcher.reconstruct(scene.frame, Silent())
    error = np.abs(depth.depth_mm.astype(np.float64) - scene.true_depth_mm)
    score = score_depth(depth, scene.true_depth_mm, scene.region)
    reached = one.visibility.lit & (one.visibility.views > 0)
    known = scene.region & np.isfinite(scene.true_depth_mm)
    inside_error, inside = find_interior_errors(depth, scene)
    ratios = compute_sigma_ratios(inside_error, depth.sigma_mm[inside])
    dark = known & ~reached
    volume_error, volume_sigma = _compare_volume(depth, one)
    return Figures(
        score.within_1mm,
        float(reached[known].mean()),
        score.gross,
        float(ratios.min()),
        float(ratios.max()),
        float((np.nan_to_num(error[dark]) > GROSS_MM).mean()) if dark.any() else 0.0,
        volume_error,
        volume_sigma,
    )


def _compare_volume(depth: DepthMap, one: AblationScene) -> tuple[float, float]:
    """Return the error of the volume and its σ, relative to the true volume; NaN without a load."""
    volume, true_mm3 = measure_load(depth, one), one.scene.true_volume_mm3
    if volume is None or true_mm3 is None:
        return np.nan, np.nan
    return volume.volume_mm3 / true_mm3 - 1, volume.sigma_mm3 / true_mm3


def read_scene(name: str, scenario: Scenario, cache: Path = CACHE) -> AblationScene:
    """Return a scene, rendered into the cache where it is not there yet."""
    return read_own(name, scenario, cache / name.replace(": ", "_").replace(" ", "_"))


def play(names: list[str], presets: list[str], cache: Path, least: float | None = None) -> Iterator[str]:
    """Yield the rows of the chosen scenes and presets, whose least confidence ``least`` replaces if given."""
    changes = {} if least is None else {"least_confidence": least}
    chosen = {
        name: scenario for name, scenario in list_scenarios().items() if any(text in name for text in names)
    }
    for name, scenario in chosen.items():
        one = read_scene(name, scenario, cache)
        for preset in presets:
            figures = measure(one, MultiviewSettings.preset(preset).model_copy(update=changes))
            nothing = format_cells([preset, name, "no surface found", *[""] * (len(HEAD) - 3)])
            yield figures.format(preset, name) if figures else nothing


NOTES = """Scenes that differ from one plant in one respect each (`benchmarks/matching/axes.toml`); no network and no
constant was fitted to them. The rig and the empty belt are exact. *In reach*: share of the true pixels that the
projector lights and an auxiliary sees; *invented*: of those that no auxiliary sees lit, the share with a depth off by
more than 5 mm; *volume*: error of the load of one frame, holes filled, its σ, and the error in σ."""


def other_plants() -> list[str]:
    """Return the table of all scenes and of the presets."""
    return [NOTES, "", *format_head(HEAD), *play([""], PRESETS, CACHE)]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", nargs="*", default=[""])
    parser.add_argument("--presets", nargs="*", default=PRESETS)
    parser.add_argument("--least-confidence", type=float)
    parser.add_argument("--cache", type=Path, default=CACHE)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    lines = format_head(HEAD)
    print("\n".join(lines))
    for row in play(arguments.scenes, arguments.presets, arguments.cache, arguments.least_confidence):
        lines.append(row)
        print(row, flush=True)
    if arguments.out is not None:
        arguments.out.write_text("\n".join(lines) + "\n", "utf-8")


if __name__ == "__main__":
    main()
