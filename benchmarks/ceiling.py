"""Ceilings of the matcher's accuracy: what perfect decisions on the surfaces it has found would reach.

    python benchmarks/ceiling.py [--rendered FOLDER] [--cache FOLDER] [--scenes TEXT …] [--plants [TEXT …]]

The scenes are those of ablation.py, and with --plants those of axes.py whose names contain one of the texts. The
columns are shares of the true pixels of the surface, as in its tables:

reached         measured within 1 mm
from the truth  the same where the last least squares begin on the true surface: what the networks reject of it
accepted right  within 1 mm if every right surface were accepted and every wrong one rejected
right candidate the same if moreover an oracle gave each uncertain pixel the best of its candidates
within 2 mm     the same within 2 mm: candidates are planes continued over up to 8 px, and are refined afterwards
no texture      whose images do not vary more than their noise

A second table says where the pixels lie that are not measured within 1 mm. Its classes exclude each other:

unseen          seen by no auxiliary: nothing tells their depth
in shadow       the projector does not light them: they show no dots
one view        lit, and seen by one auxiliary: where the dots fit by chance, no other view says so
near a step     lit, seen by two auxiliaries or more, within 6 px of a step of the true depth
elsewhere       all others

A cell has the class's share of the true pixels, and which share of the true pixels is in it and not reached.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from axes import list_scenarios, read_scene
from beltscape.core.depth import DepthMap
from beltscape.core.progress import Silent
from beltscape.stereo.multiview.candidates import CandidateSelector
from beltscape.stereo.multiview.depth_range import find_depth_range
from beltscape.stereo.multiview.estimate import estimate_depth
from beltscape.stereo.multiview.features import ConfidenceInputs, MatcherState, compute_selection_features
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor, make_depth_map
from beltscape.stereo.multiview.surface import Surface
from beltscape.stereo.settings import MultiviewSettings
from captures import Scene
from matching.scenes import AblationScene, make_scene_parser, read_scenes
from matching.visibility import CLASSES
from tables import format_cells, format_head

_STEEPEST = 2.0
"""Limit of the true surface's slopes, which differences across steps exceed."""
HEAD = (
    "scene",
    "reached",
    "from the truth",
    "accepted right",
    "right candidate",
    "within 2 mm",
    "no texture",
)


def measure_ceilings(one: AblationScene) -> tuple[list[float], dict[str, tuple[float, float]]]:
    """Return the shares of a scene, in the order of `HEAD`, and those of the classes with what they miss."""
    scene = one.scene
    near_far = find_depth_range(scene.rig, scene.frame, Silent())
    matcher = MultiviewReconstructor(scene.rig, near_far, MultiviewSettings())
    reached = _compute_error(matcher.reconstruct(scene.frame, Silent()).depth_mm, scene)
    state = matcher.match(scene.frame, scene.rig.auxiliaries, Silent())
    unit = state.prepared.context.inverse_depth_scale
    from_truth = _compute_error(_match_from_truth(matcher, state, scene).depth_mm, scene)
    accepted = np.fmin(_compute_error(1 / (estimate_depth(state).surface.s * unit), scene), reached)
    selected = np.fmin(accepted, _find_best_candidates(matcher, scene))
    counted = scene.region & np.isfinite(scene.true_depth_mm)

    def share(mask: np.ndarray) -> float:
        return float(mask[counted].mean())

    ceilings = [
        share(reached < 1), share(from_truth < 1), share(accepted < 1), share(selected < 1), share(selected < 2),
        share(~state.textured),
    ]  # fmt: skip
    classes = one.visibility.classify(scene.true_depth_mm) if one.visibility else {}
    return ceilings, {name: (share(mask), share(mask & (reached >= 1))) for name, mask in classes.items()}


def _compute_error(depth_mm: np.ndarray, scene: Scene) -> np.ndarray:
    """Return the size of the error (H, W), mm; infinite where nothing is measured."""
    return np.nan_to_num(np.abs(depth_mm - scene.true_depth_mm), nan=np.inf)


def _match_from_truth(matcher: MultiviewReconstructor, state: MatcherState, scene: Scene) -> DepthMap:
    """Return the depth map of the last least squares begun on the true surface, where it is known."""
    context = state.prepared.context
    rows, columns = (slice(context.step // 2, None, context.step),) * 2
    height, width = state.solution.surface.s.shape
    true_s = 1 / (scene.true_depth_mm[rows, columns][:height, :width] * context.inverse_depth_scale)
    s = np.where(np.isfinite(true_s), true_s, state.solution.surface.s).astype(np.float32)
    slope_v, slope_u = (
        np.nan_to_num(np.clip(slope, -_STEEPEST, _STEEPEST)).astype(np.float32) for slope in np.gradient(s)
    )
    solution = matcher.solve_finally(Surface(s, slope_u, slope_v), state.prepared)
    estimate = estimate_depth(replace(state, solution=solution))
    return make_depth_map(estimate, context, matcher.settings.least_confidence)


def _find_best_candidates(matcher: MultiviewReconstructor, scene: Scene) -> np.ndarray:
    """Return the error (H, W), mm, of the best candidate of each uncertain pixel; infinite elsewhere."""
    state = matcher.solve_pyramid(scene.frame, scene.rig.auxiliaries)
    unit = state.prepared.context.inverse_depth_scale
    planes = compute_selection_features(ConfidenceInputs.from_state(state))
    selector = CandidateSelector.from_surface(state.solution.surface, planes, state.prepared)
    best = np.full(scene.true_depth_mm.shape, np.inf)
    for pixels in selector.find_uncertain_pixels():
        candidates, _ = selector.find_candidates(pixels)
        error = np.abs(1 / (candidates.s * unit) - scene.true_depth_mm[pixels])
        best[pixels] = np.fmin.reduce(error)
    return np.nan_to_num(best, nan=np.inf)


def _choose_scenes(arguments: argparse.Namespace) -> Iterator[AblationScene]:
    """Yield the scenes that the arguments choose."""
    if arguments.plants is None:
        yield from read_scenes(arguments)
        return
    for name, scenario in list_scenarios().items():
        if any(text in name for text in arguments.plants or [""]):
            yield read_scene(name, scenario)


def main() -> None:
    """Print both tables, with a row for every scene."""
    parser = make_scene_parser(__doc__)
    parser.add_argument("--plants", nargs="*", metavar="TEXT", help="take the scenes of axes.py instead")
    arguments = parser.parse_args()
    missing = format_head(("scene", *CLASSES))
    print("\n".join(format_head(HEAD)))
    for one in _choose_scenes(arguments):
        ceilings, classes = measure_ceilings(one)
        print(format_cells([one.scene.name, *(f"{value:.2%}" for value in ceilings)]), flush=True)
        cells = (f"{share:.1%}, {missed:.2%} missed" for share, missed in classes.values())
        missing.append(format_cells([one.scene.name, *cells]))
    print("\n" + "\n".join(missing))


if __name__ == "__main__":
    main()
