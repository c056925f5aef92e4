"""Beltscape beside other matchers on the same captures in one run; writes PEERS.md.

    pip install 'beltscape[simulate,bench]'
    python benchmarks/other_matchers.py [RENDERED] [--scenes TEXT …] [--out FILE]

The peers match rectified pairs and are averaged over the pairs as the paper's method is: OpenCV's SGBM, and CNES
Pandora with a census cost and with the learned cost MC-CNN, both optimised by libSGM. RENDERED is a folder of
rendered captures with truth (default: ../shared/data/rendered beside the repository), taken at half size; without one
the capture that ships with the demo is used. The scenes of another maker's rig are rendered once, into
out/bench-axes.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist

import numpy as np

from axes import list_scenarios, read_scene
from beltscape.core.depth import DepthMap
from beltscape.core.progress import Silent
from beltscape.core.statistics import compute_median
from beltscape.evaluate.depth_scores import interior_mask, score_depth
from beltscape.evaluate.frame_scores import compute_false_fill
from beltscape.stereo.multiview.depth_range import find_depth_range
from captures import Scene, demo_scenes, read_rendered
from matching.methods import Range, make_matcher
from matching.pandora_pairs import COSTS, COVERAGE, PairResult, PandoraMatcher
from matching.scenes import ROOT
from results import current_commit
from tables import format_cells, format_head

HEAD = (
    "method",
    "< 1 mm",
    "< 0.25 mm",
    "gross",
    "measured",
    "false fill",
    "σ ratio",
    "90 % interval holds",
    "its width mm",
    "CPU s",
)
_OWN = ("module", "belt_loaded")
_STRANGER = "stranger"
_TWO_SIDED = NormalDist().inv_cdf(0.5 + COVERAGE / 2)
"""Half width of a normal distribution's interval of `COVERAGE`, in standard deviations."""
_LIBRARIES = "opencv-python-headless", "pandora", "pandora_plugin_mccnn", "libsgm"


@dataclass(frozen=True)
class MatchedDepth:
    """The result of a method: its depth, and the nearest and farthest ends (H, W) of each of its intervals, mm."""

    depth: DepthMap
    intervals: list[tuple[np.ndarray, np.ndarray]]


def match_by_own(name: str, scene: Scene, near_far: Range) -> Callable[[], MatchedDepth]:
    """Return a function that matches a scene by a method of ours, whose intervals follow from σ."""
    work = make_matcher(name, scene, near_far, 0)

    def run() -> MatchedDepth:
        depth = work()
        half = _TWO_SIDED * depth.sigma_mm
        return MatchedDepth(depth, [(depth.depth_mm - half, depth.depth_mm + half)])

    return run


def match_by_pandora(cost: str, scene: Scene, near_far: Range) -> Callable[[], MatchedDepth]:
    """Return a function that matches a scene by Pandora, each of whose pairs has intervals."""
    matcher = PandoraMatcher(scene.rig, near_far, cost)

    def run() -> MatchedDepth:
        depth, pairs = matcher.match(scene)
        return MatchedDepth(depth, [_get_interval(pair) for pair in pairs])

    return run


def _get_interval(pair: PairResult) -> tuple[np.ndarray, np.ndarray]:
    return pair.nearest_mm, pair.farthest_mm


METHODS: dict[str, Callable[[Scene, Range], Callable[[], MatchedDepth]]] = {
    "Beltscape, standard": lambda scene, near_far: match_by_own("standard", scene, near_far),
    "Beltscape, fast": lambda scene, near_far: match_by_own("fast", scene, near_far),
    "OpenCV SGBM, pairs averaged": lambda scene, near_far: match_by_own("pairwise", scene, near_far),
    **{
        f"Pandora, {cost} and SGM, pairs averaged": (
            lambda scene, near_far, cost=cost: match_by_pandora(cost, scene, near_far)
        )
        for cost in COSTS
    },
}


def score_match(name: str, match: MatchedDepth, scene: Scene, cpu_s: float) -> str:
    """Return a row of the table."""
    true, depth = scene.true_depth_mm, match.depth
    score = score_depth(depth, true, scene.region)
    inside = scene.region & interior_mask(true)
    held, widths = [], []
    for nearest, farthest in match.intervals:
        known = inside & np.isfinite(nearest) & np.isfinite(farthest)
        held.append(((nearest <= true) & (true <= farthest))[known])
        widths.append((farthest - nearest)[known])
    cells = (
        name, f"{score.within_1mm:.1%}", f"{score.within_quarter_mm:.1%}", f"{score.gross:.2%}",
        f"{score.coverage:.1%}", f"{compute_false_fill(depth, scene.occluded):.1%}",
        _format(score.sigma_ratio, ".2f"), _format(_mean(np.concatenate(held)), ".1%"),
        _format(compute_median(np.concatenate(widths)), ".2f"), f"{cpu_s:.1f}",
    )  # fmt: skip
    return format_cells(cells)


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else np.nan


def _format(value: float, form: str) -> str:
    return "–" if np.isnan(value) else format(value, form)


def read_scenes(rendered: Path, names: list[str]) -> Iterator[Scene]:
    """Yield the scenes: module and loaded belt of the paper's rig, and those of another maker's."""

    def is_chosen(name: str) -> bool:
        return any(text in name for text in names)

    own = (
        (read_rendered(rendered, name, 1) for name in _OWN if is_chosen(name))
        if rendered.is_dir()
        else (scene for scene in demo_scenes() if scene.name in _OWN and is_chosen(scene.name))
    )
    yield from own
    for name, scenario in list_scenarios().items():
        if name.startswith(_STRANGER) and is_chosen(name):
            yield read_scene(name, scenario).scene


def compare(scene: Scene) -> Iterator[str]:
    """Yield the lines of a scene's table."""
    near_far = find_depth_range(scene.rig, scene.frame, Silent())
    yield from ("", f"## {scene.name}, {scene.size}, {len(scene.rig.auxiliaries)} auxiliaries", "")
    yield from format_head(HEAD)
    for name, make in METHODS.items():
        work = make(scene, near_far)
        start = time.process_time()
        match = work()
        yield score_match(name, match, scene, time.process_time() - start)


def main() -> None:
    """Compare all methods on the chosen scenes and write the file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "rendered", nargs="?", type=Path, default=ROOT.parent / "shared" / "data" / "rendered"
    )
    parser.add_argument("--scenes", nargs="*", default=[""])
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("PEERS.md"))
    arguments = parser.parse_args()
    logging.disable(logging.WARNING)  # Pandora's state machine warns of its own names
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in _LIBRARIES)
    lines = [
        "# Peers", "",
        "Written by `python benchmarks/other_matchers.py`: Beltscape beside other matchers, with exact rigs, on the",
        f"same images in the same run at commit {current_commit()}, {versions}.", "",
        "Shares are of all true pixels of the scene's surface that the projector can light; gross: off by more than",
        "5 mm, of the measured; false fill: pixels that no auxiliary sees and that carry a depth. The interval is",
        f"that of {COVERAGE:.0%}: ±1.64 σ of the averaged depth, and Pandora's own intervals of each pair; holds:",
        "share of the measured pixels away from steps whose true depth lies within it; –: all lie near steps. MC-CNN",
        "has the weights that Pandora ships. CPU s: of a frame of a prepared matcher, its first. Programs of digital",
        "image correlation are not among the peers: OpenCorr is in no package registry, and muDIC fits one smooth",
        "mesh to the whole image.",
    ]  # fmt: skip
    for scene in read_scenes(arguments.rendered, arguments.scenes):
        for line in compare(scene):
            lines.append(line)
            print(line, flush=True)
    arguments.out.write_text("\n".join(lines) + "\n", "utf-8")


if __name__ == "__main__":
    main()
