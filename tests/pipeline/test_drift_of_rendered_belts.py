"""The drift of a rig by rendered images of a moving belt: a camera that moved, and a rig at rest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.rig_json import write_rig
from beltscape.pipeline.reconstructing.checked_matcher import CheckedMatcher
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.scene_assembly import SimulatedScene
from beltscape.stereo.consistency.drift import (
    NOTHING,
    Drift,
    DriftAccumulator,
    DriftWindow,
    apply_drift,
    estimate_drift,
)
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings

pytestmark = pytest.mark.thorough

FRAMES = 30
SCENE: dict[str, Any] = {
    "kind": "belt_moving",
    "frames": 2 * FRAMES,
    "rig": {"size_px": (936, 784), "pitch_um": 9.0, "scale": 0.5, "auxiliaries": 2},
    "render": {"oversample": 1, "passes": 1, "ambient_samples": 1},
    "motion": {"start_mm": -200.0, "speed_mm_s": 200.0},
}
"""Three cameras of 468 × 392 px, of 0.45 px to a milliradian; the heap goes by slowly."""
MOVED = {"cam2": np.array([6e-4, -4e-4, 3e-4, 0.2, -0.2, 0.0, 0.0])}
DEPTH_MM = (560.0, 800.0)


def make_scene(rig: Path | None = None) -> SimulatedScene:
    """Return the scene of the plant, or of a rig given by its file."""
    values = SCENE if rig is None else {**SCENE, "rig": {"file": rig}}
    return SimulatedScene(Scenario.model_validate(values))


def watch(scene: SimulatedScene, rig: Rig, first: int) -> DriftWindow:
    """Return the window of frames that are matched and checked by a rig."""
    window = DriftAccumulator(rig)

    def make_matcher(names: tuple[str, ...]) -> MultiviewReconstructor:
        return MultiviewReconstructor(rig, DEPTH_MM, MultiviewSettings.preset("fast"), auxiliaries=names)

    matcher = CheckedMatcher(rig, rig.auxiliaries, DEPTH_MM, make_matcher, None, window.add, every=1)
    for frame in range(first, first + FRAMES):
        matcher.reconstruct(scene.render_frame(frame), Silent())
    return window.close()


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Rig, Rig, DriftWindow]:
    """A folder, the true rig, the calibrated one, which errs as calibrations do, and its reference window."""
    scene = make_scene()
    true = scene.station.rig
    rng, error = np.random.default_rng(1), np.array([1e-4, 1e-4, 1e-4, 0.03, 0.03, 0.03, 1e-4])
    rig = apply_drift(true, {name: rng.normal(size=7) * error for name in true.auxiliaries})
    return tmp_path_factory.mktemp("drift"), true, rig, watch(scene, rig, 0)


def describe(found: Drift) -> str:
    sigma = np.sqrt(np.diag(found.covariance))
    return f"{found.moved}, χ² {found.chi_square:.0f} of {found.medians}, left {found.left:.2f}\n{found.change}\n{sigma}"


def test_a_rig_at_rest_is_not_accused_while_the_heap_goes_by(plant) -> None:
    _, _, rig, reference = plant
    found = estimate_drift(watch(make_scene(), rig, FRAMES), reference, rig)
    assert found.moved == NOTHING, describe(found)
    assert found.medians > 40


def test_a_camera_that_was_knocked_is_found_within_two_sigma(plant) -> None:
    folder, true, rig, reference = plant
    write_rig(folder / "rig.json", apply_drift(true, MOVED))
    found = estimate_drift(watch(make_scene(folder / "rig.json"), rig, FRAMES), reference, rig)
    assert found.moved == "cam2", describe(found)
    sigma = np.sqrt(np.diag(found.covariance))
    errors = (found.get_changes()["cam2"] - MOVED["cam2"]) / sigma[sigma > 0]
    assert (np.abs(errors) < 2).all(), f"{errors}\n{describe(found)}"
    assert (np.abs(MOVED["cam2"][:2]) > 3 * sigma[sigma > 0][:2]).all()
