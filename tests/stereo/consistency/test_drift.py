"""Drift by tie points of ordinary frames: known movements within their σ, and no accusation without one."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beltscape.stereo.consistency.drift import (
    COMMON,
    NOTHING,
    PARAMETERS,
    Drift,
    apply_drift,
    estimate_drift,
    read_window,
)
from tests.synthetic.drifting_rigs import make_reference, make_rig, make_true_rig, make_window
from tests.thorough import count_examples

MOVED = {
    "turn": {"cam2": [3e-4, 0, 0, 0, 0, 0, 0]},
    "knock": {"cam2": [1e-3, -1e-3, 5e-4, 0.3, 0.2, 0.1, 0]},
    "core": {"cam0": [4e-4, 4e-4, 0, 0, 0.2, 0, 0]},
    "focal": {"cam3": [0, 0, 0, 0, 0, 0, 5e-4]},
}


def estimate(changes: dict[str, list[float]], seed: int = 7) -> Drift:
    true = apply_drift(make_true_rig(), {name: np.array(row) for name, row in changes.items()})
    return estimate_drift(make_window(true, seed), make_reference(), make_rig())


def standardise(found: Drift, changes: dict[str, list[float]]) -> np.ndarray:
    """Return the errors of what is estimated, over their σ; what is not must not have changed."""
    true = np.concatenate([changes.get(name, [0.0] * len(PARAMETERS)) for name in found.cameras])
    sigma = np.sqrt(np.diag(found.covariance))
    np.testing.assert_array_equal(true[sigma == 0], 0.0)
    return (found.change - true)[sigma > 0] / sigma[sigma > 0]


@pytest.mark.parametrize("case", MOVED)
def test_a_camera_that_moved_is_named_and_where_it_is_found(case: str) -> None:
    found = estimate(MOVED[case])
    assert [found.moved] == list(MOVED[case])
    errors = standardise(found, MOVED[case])
    assert np.abs(errors).max() < 3
    assert np.mean(np.abs(errors) < 2) >= 6 / 7


def test_cameras_that_all_moved_are_found_up_to_the_common_scale() -> None:
    rng = np.random.default_rng(3)
    step = [5e-4, 5e-4, 5e-4, 0.1, 0.1, 0.1, 2e-4]
    moved = {name: list(rng.normal(size=7) * step) for name in make_rig().auxiliaries}
    found = estimate(moved)
    assert found.moved == COMMON
    assert np.mean(np.abs(standardise(found, moved)) < 2) > 0.9


@pytest.mark.parametrize("seed", range(count_examples(20)))
def test_a_rig_at_rest_is_not_accused(seed: int) -> None:
    """Though its calibration errs, by up to a pixel: the reference window has the same residuals."""
    found = estimate({}, 100 + seed)
    assert found.moved == NOTHING
    assert not found.change.any()
    assert not found.get_changes()
    assert (np.diag(found.covariance) > 0).sum() == 7 * 4 + 1
    assert all(rms < 3 * sigma for rms, sigma in found.row_px.values())


def test_a_window_reads_back_from_its_document() -> None:
    reference = make_reference()
    again = read_window(json.loads(json.dumps(reference.to_document())))
    np.testing.assert_allclose(again.mean_px, reference.mean_px, atol=1e-6)
    np.testing.assert_allclose(again.variance_px2, reference.variance_px2, rtol=1e-3)
    assert (again.names, again.frames) == (reference.names, reference.frames)


def test_a_camera_without_images_is_left_as_it_is() -> None:
    """Blocks of too few frames are in neither window."""
    reference = make_reference()
    few = make_window(make_true_rig(), 3, frames=5)
    found = estimate_drift(few, reference, make_rig())
    assert (found.moved, found.medians) == (NOTHING, 0)
