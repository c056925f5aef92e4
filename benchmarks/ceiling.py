"""Ceilings of the matcher's accuracy: what perfect decisions on the surfaces it has found would reach.

    python benchmarks/ceiling.py [--rendered FOLDER] [--cache FOLDER] [--scenes TEXT …]

The scenes are those of ablation.py. The columns are shares of the true pixels of the surface, as in its tables:

reached         measured within 1 mm
accepted right  within 1 mm if every right surface were accepted and every wrong one rejected
right candidate the same if moreover an oracle gave each uncertain pixel the best of its candidates
within 2 mm     the same within 2 mm: candidates are planes continued over up to 8 px, and are refined afterwards
unseen          seen by no auxiliary: nothing tells their depth
one view        seen by one auxiliary
no texture      whose images do not vary more than their noise
"""

from __future__ import annotations

import numpy as np

from beltscape.core.progress import Silent
from beltscape.stereo.multiview.confidence.estimate import estimate_depth
from beltscape.stereo.multiview.confidence.features import ConfidenceInputs, compute_selection_features
from beltscape.stereo.multiview.initialisation.depth_range import find_depth_range
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.multiview.selection.candidates import CandidateSelector
from beltscape.stereo.multiview.settings import MultiviewSettings
from captures import Scene
from matching.scenes import AblationScene, make_scene_parser, read_scenes

HEAD = (
    "scene",
    "reached",
    "accepted right",
    "right candidate",
    "within 2 mm",
    "unseen",
    "one view",
    "no texture",
)


def measure_ceilings(one: AblationScene) -> list[float]:
    """Return the shares of a scene, in the order of `HEAD`; NaN where the truth does not say."""
    scene = one.scene
    near_far = find_depth_range(scene.rig, scene.frame, Silent())
    matcher = MultiviewReconstructor(scene.rig, near_far, MultiviewSettings())
    reached = _compute_error(matcher.reconstruct(scene.frame, Silent()).depth_mm, scene)
    state = matcher.match(scene.frame, scene.rig.auxiliaries, Silent())
    unit = state.prepared.context.inverse_depth_scale
    accepted = np.fmin(_compute_error(1 / (estimate_depth(state).surface.s * unit), scene), reached)
    selected = np.fmin(accepted, _find_best_candidates(matcher, scene))
    views = one.views
    counted = scene.region & np.isfinite(scene.true_depth_mm)

    def share(mask: np.ndarray) -> float:
        return float(mask[counted].mean())

    return [
        share(reached < 1), share(accepted < 1), share(selected < 1), share(selected < 2),
        np.nan if views is None else share(views == 0), np.nan if views is None else share(views == 1),
        share(~state.textured),
    ]  # fmt: skip


def _compute_error(depth_mm: np.ndarray, scene: Scene) -> np.ndarray:
    """Return the size of the error (H, W), mm; infinite where nothing is measured."""
    return np.nan_to_num(np.abs(depth_mm - scene.true_depth_mm), nan=np.inf)


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


def main() -> None:
    """Print a row for every scene."""
    parser = make_scene_parser(__doc__)
    arguments = parser.parse_args()
    print("| " + " | ".join(HEAD) + " |")
    print("|" + "---|" * len(HEAD))
    for one in read_scenes(arguments.cache, arguments.rendered):
        if any(text in one.scene.name for text in arguments.scenes):
            cells = ["" if np.isnan(value) else f"{value:.2%}" for value in measure_ceilings(one)]
            print(f"| {one.scene.name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
