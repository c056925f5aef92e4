"""The drift of a rig by rendered images of a moving belt: a camera that moved, and a rig at rest."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from beltscape.core.arrays import Array
from beltscape.core.frames import FrameSet
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
CAMERA = "cam2"
TURN = np.array([2.5e-4, -1.5e-4, 2e-4, 0.0, 0.0, 0.0, 0.0])
KNOCK = np.array([6e-4, -4e-4, 3e-4, 0.2, -0.2, 0.0, 0.0])
"""0.4 px, of which the check of poses tolerates a quarter."""
DEPTH_MM = (560.0, 800.0)


def make_scene(rig: Path | None = None) -> SimulatedScene:
    """Return the scene of the plant, or of a rig given by its file."""
    values = SCENE if rig is None else {**SCENE, "rig": {"file": rig}}
    return SimulatedScene(Scenario.model_validate(values))


def render_frames(scene: SimulatedScene, first: int) -> list[FrameSet]:
    return [scene.render_frame(frame) for frame in range(first, first + FRAMES)]


def accumulate(frames: Iterable[FrameSet], rig: Rig) -> DriftWindow:
    """Return the window of frames that are matched and checked by a rig."""
    window = DriftAccumulator(rig)

    def make_matcher(names: tuple[str, ...]) -> MultiviewReconstructor:
        return MultiviewReconstructor(rig, DEPTH_MM, MultiviewSettings.preset("fast"), auxiliaries=names)

    matcher = CheckedMatcher(rig, rig.auxiliaries, DEPTH_MM, make_matcher, None, window.add, every=1)
    for frame in frames:
        matcher.reconstruct(frame, Silent())
    return window.close()


def turn_camera(frames: FrameSet, rig: Rig, name: str, change: Array) -> FrameSet:
    """Return the frame as the camera would take it turned about its centre."""
    camera, before = rig.cameras[name], rig.cam_from_core[name]
    turn = (apply_drift(rig, {name: change}).cam_from_core[name] @ before.inverse()).rotation
    pixels = np.stack(np.meshgrid(*map(np.arange, camera.size_px)), axis=-1).reshape(-1, 2).astype(np.float64)
    rays = np.column_stack([camera.undistort(pixels), np.ones(len(pixels))])
    source = camera.project(rays @ turn).reshape(*camera.size_px[::-1], 2).astype(np.float32)
    image = cv2.remap(frames.images[name], source, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return FrameSet(frames.frame, {**frames.images, name: np.asarray(image, np.uint8)})


@dataclass(frozen=True)
class Plant:
    """A rig as it truly is, the calibrated one, which errs as calibrations do, its reference, and later frames."""

    true: Rig
    rig: Rig
    reference: DriftWindow
    later: Sequence[FrameSet]

    def estimate(self, frames: Iterable[FrameSet]) -> Drift:
        return estimate_drift(accumulate(frames, self.rig), self.reference, self.rig)


@pytest.fixture(scope="module")
def plant() -> Plant:
    scene = make_scene()
    true = scene.station.rig
    rng, error = np.random.default_rng(1), np.array([1e-4, 1e-4, 1e-4, 0.03, 0.03, 0.03, 1e-4])
    rig = apply_drift(true, {name: rng.normal(size=7) * error for name in true.auxiliaries})
    return Plant(true, rig, accumulate(render_frames(scene, 0), rig), render_frames(scene, FRAMES))


def standardise(found: Drift, change: Array) -> tuple[Array, float]:
    """Return the errors of a camera's change over their σ, and their χ², which their correlations decide."""
    assert found.moved == CAMERA
    error = found.get_changes()[CAMERA] - change
    place = len(error) * found.cameras.index(CAMERA) + np.arange(len(error))
    covariance = found.covariance[np.ix_(place, place)]
    return error / np.sqrt(np.diag(covariance)), float(error @ np.linalg.solve(covariance, error))


def test_a_rig_at_rest_is_not_accused_while_the_heap_goes_by(plant) -> None:
    found = plant.estimate(plant.later)
    assert found.moved == NOTHING
    assert found.medians > 20


def test_a_camera_that_turned_by_a_tenth_of_a_pixel_is_found_within_two_sigma(plant) -> None:
    found = plant.estimate(turn_camera(each, plant.true, CAMERA, TURN) for each in plant.later)
    errors, chi_square = standardise(found, TURN)
    assert np.abs(errors).max() < 2
    assert chi_square < chi2.ppf(0.95, len(TURN))


def test_a_camera_that_was_knocked_beyond_the_tolerance_is_found_too(plant, tmp_path) -> None:
    """Some of its frames are rejected, and the points that moved farthest are lost: errors are below 3 σ."""
    write_rig(tmp_path / "rig.json", apply_drift(plant.true, {CAMERA: KNOCK}))
    found = plant.estimate(render_frames(make_scene(tmp_path / "rig.json"), FRAMES))
    errors, chi_square = standardise(found, KNOCK)
    assert np.abs(errors).max() < 3
    assert chi_square < chi2.ppf(0.99, len(KNOCK))
