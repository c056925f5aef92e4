"""Gain and cost of each stage of the matcher: every stage switched off in turn, on scenes with exact truth.

    python benchmarks/ablation.py [--rendered FOLDER] [--cache FOLDER] [--scenes TEXT …] [--rows TEXT …] [--out FILE]

The scenes (matching/scenes.toml) were used for no fit. A stage that is switched off is left out without training the
networks behind it anew, so a row shows what the matcher loses as it is shipped, not what a matcher built without the
stage would reach. The table gives, for every scene and as the mean, shares of all true pixels of the scene's surface
within 1 mm and 0.25 mm, gross errors (> 5 mm, of the measured), false fill (share of the pixels without a view that
carry a depth), the actual over the predicted σ (least and greatest over fifths), the error of the volume, and
processor seconds.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.progress import Silent
from beltscape.evaluate.depth_scores import score_depth
from beltscape.evaluate.frame_scores import compute_false_fill, compute_sigma_ratios
from beltscape.stereo.multiview import estimate
from beltscape.stereo.multiview.depth_range import find_depth_range
from beltscape.stereo.multiview.estimate import OFFSETS
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.multiview.textureless import FilledDiscs
from beltscape.stereo.settings import MultiviewSettings
from matching.methods import find_interior_errors
from matching.scenes import AblationScene, make_scene_parser, measure_load, read_scenes
from tables import format_cells, format_head

_RUNS = 2
"""Runs of each row on each scene; the least processor time counts."""
_RECONSTRUCTOR = "beltscape.stereo.multiview.reconstructor"


@dataclass(frozen=True)
class Row:
    """A variant of the matcher."""

    name: str
    preset: str = "standard"
    changes: dict[str, object] | None = None
    """Settings that differ from the preset's."""
    patched: Callable[[], AbstractContextManager[object]] = nullcontext


def _only_own_messages(address, uncertain, spacing):  # noqa: ARG001
    return np.repeat(address[uncertain][None], len(OFFSETS), 0)


def _refine_everywhere() -> AbstractContextManager[object]:
    """Let one network, that of the refinement, judge every pixel."""
    return patch.multiple(
        estimate,
        mask_uncertain=lambda logit: np.ones(logit.shape, bool),
        mask_accepted=lambda logit: np.zeros(logit.shape, bool),
    )


def _no_discs(surface, _information, _prepared):
    return FilledDiscs(surface, np.zeros(surface.s.shape, bool))


ROWS = (
    Row("standard, all stages"),
    Row("fast", "fast"),
    Row("without candidate selection", changes={"candidate_selection": False}),
    Row(
        "without neighbours' messages",
        patched=lambda: patch.object(estimate, "gather_neighbour_addresses", _only_own_messages),
    ),
    Row(
        "without refinement and messages",
        patched=lambda: patch.object(estimate, "refine_uncertain_pixels", lambda found, *_: found),
    ),
    Row("refinement of every pixel", patched=_refine_everywhere),
    Row(
        "without textureless discs",
        patched=lambda: patch(f"{_RECONSTRUCTOR}.fill_textureless_discs", _no_discs),
    ),
    Row("without twicing", changes={"twicing": False}),
    Row("one round of propagation", changes={"rounds": 1}),
    Row(
        "without correlated noise",
        patched=lambda: patch.object(estimate, "inflate_sigma", lambda sigma, _: sigma),
    ),
)


@dataclass(frozen=True)
class Figures:
    """The figures of a row on a scene."""

    within_1mm: float
    within_quarter_mm: float
    gross: float
    false_fill: float
    sigma_low: float
    sigma_high: float
    volume_error: float
    cpu_s: float


HEAD = ("row", "< 1 mm", "< 0.25 mm", "gross", "false fill", "σ ratio in fifths", "volume", "CPU s")


def measure(row: Row, one: AblationScene, near_far_mm: tuple[float, float]) -> Figures:
    """Match a scene by a variant of the matcher and score it."""
    scene = one.scene
    settings = MultiviewSettings.preset(row.preset).model_copy(update=row.changes or {})
    with row.patched():
        matcher = MultiviewReconstructor(scene.rig, near_far_mm, settings)
        costs: list[float] = []
        depth: DepthMap | None = None
        for _ in range(_RUNS):
            start = time.process_time()
            depth = matcher.reconstruct(scene.frame, Silent())
            costs.append(time.process_time() - start)
    assert depth is not None
    score = score_depth(depth, scene.true_depth_mm, scene.region)
    error, inside = find_interior_errors(depth, scene)
    ratios = compute_sigma_ratios(error, depth.sigma_mm[inside])
    return Figures(
        score.within_1mm, score.within_quarter_mm, score.gross, compute_false_fill(depth, scene.occluded),
        float(ratios.min()), float(ratios.max()), _measure_volume_error(depth, one), min(costs),
    )  # fmt: skip


def _measure_volume_error(depth: DepthMap, one: AblationScene) -> float:
    volume, true_mm3 = measure_load(depth, one), one.scene.true_volume_mm3
    return np.nan if volume is None or true_mm3 is None else volume.volume_mm3 / true_mm3 - 1


def format_row(name: str, figures: Sequence[Figures]) -> str:
    """Return a table row with the means over scenes; the volume's is that of its size, σ's the extremes."""

    def mean(values: Sequence[float]) -> float:
        known = [value for value in values if np.isfinite(value)]
        return float(np.mean(known)) if known else np.nan

    one = len(figures) == 1
    volume = mean([f.volume_error if one else abs(f.volume_error) for f in figures])
    cells = (
        name,
        f"{mean([f.within_1mm for f in figures]):.2%}",
        f"{mean([f.within_quarter_mm for f in figures]):.2%}",
        f"{mean([f.gross for f in figures]):.2%}",
        f"{mean([f.false_fill for f in figures]):.1%}",
        f"{min(f.sigma_low for f in figures):.2f}–{max(f.sigma_high for f in figures):.2f}",
        f"{volume:+.2%}" if one else f"{volume:.2%}",
        f"{mean([f.cpu_s for f in figures]):.2f}",
    )
    return format_cells(["" if "nan" in cell else cell for cell in cells])


def main() -> None:
    """Play the chosen rows on the chosen scenes and print a table for each, and one of the means."""
    parser = make_scene_parser(__doc__)
    parser.add_argument("--rows", nargs="*", default=[""])
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    rows = [row for row in ROWS if any(text in row.name for text in arguments.rows)]
    lines: list[str] = []
    found: dict[str, list[Figures]] = {row.name: [] for row in rows}
    head = format_head(HEAD)

    def tell(*more: str) -> None:
        lines.extend(more)
        print("\n".join(more), flush=True)

    for one in read_scenes(arguments):
        near_far = find_depth_range(one.scene.rig, one.scene.frame, Silent())
        tell("", f"### {one.scene.name}, {one.scene.size}", "", *head)
        for row in rows:
            figures = measure(row, one, near_far)
            found[row.name].append(figures)
            tell(format_row(row.name, [figures]))
    tell("", "### All scenes", "", *head, *(format_row(row.name, found[row.name]) for row in rows))
    if arguments.out is not None:
        arguments.out.write_text("\n".join(lines).strip() + "\n", "utf-8")


if __name__ == "__main__":
    main()
