"""Global optimisation of a camera network: derivatives, exact recovery, accuracy with noise."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from beltscape.calibration.network.association import CameraNetwork, associate_cameras
from beltscape.calibration.network.global_optimisation import NetworkProblem, NetworkWeights, optimise_network
from beltscape.calibration.network.global_optimisation import _make_constraints as constraints
from beltscape.calibration.network.pairs import Pair
from beltscape.calibration.network.pose_chains import exp, log
from beltscape.calibration.solver.levenberg_marquardt import Damping
from beltscape.core.geometry.rig import Rig
from tests.optional import require
from tests.synthetic.boards import row_of_cameras

UNITS = np.diag(np.repeat([1e-4, 0.1], 3))
"""Standard deviation of a pair's twist: rad, mm."""


def make_noisy_pair(rig: Rig, first: str, second: str, rng: np.random.Generator, noise: float = 1.0) -> Pair:
    """A pair with an error drawn from its own, skew, covariance."""
    mixed = rng.normal(size=(6, 6))
    covariance = UNITS @ (mixed @ mixed.T / 6 + 0.3 * np.eye(6)) @ UNITS
    error = noise * np.linalg.cholesky(covariance) @ rng.normal(size=6)
    pose = rig.relative_pose(second, first) @ exp(error)
    return Pair(first, second, pose, 0.1, ("00",), 100, covariance)


def network(
    rig: Rig, core: str, links: Iterable[tuple[str, str]], seed: int = 0, noise: float = 1.0
) -> CameraNetwork:
    rng = np.random.default_rng(seed)
    return associate_cameras(core, [make_noisy_pair(rig, *link, rng, noise) for link in links])


def errors(rig: Rig, found: CameraNetwork) -> np.ndarray:
    """(n, 2) rotation in degrees and displacement of the centre in mm."""
    rows = []
    for name, pose in found.cam_from_core.items():
        true = rig.relative_pose(name, found.core)
        rows.append([(pose.inverse() @ true).angle_deg, np.linalg.norm(pose.center_mm - true.center_mm)])
    return np.array(rows)


def perturb_network(own: CameraNetwork, seed: int = 0) -> CameraNetwork:
    rng = np.random.default_rng(seed)
    poses = {
        name: pose if name == own.core else exp(rng.normal(size=6) * np.repeat([0.05, 40.0], 3)) @ pose
        for name, pose in own.cam_from_core.items()
    }
    return replace(own, cam_from_core=poses)


@pytest.mark.parametrize(
    "weights", [NetworkWeights(), NetworkWeights(1, 0), NetworkWeights(0, 1), NetworkWeights(1, 1)]
)
@pytest.mark.parametrize("core", ["a", "c"])
def test_without_noise_the_truth_is_found_from_a_disturbed_start(rig, core, weights):
    exact = network(rig, core, combinations("abcd", 2), noise=0.0)
    start = perturb_network(exact)
    assert errors(rig, start).max(axis=0).min() > 2
    found = optimise_network(start, weights)
    assert errors(rig, found).max() < 1e-6
    assert found.initial is start
    assert found.cam_from_core[core] is start.cam_from_core[core]


def test_a_camera_without_a_core_pair_is_optimised_too(rig):
    ring = [("a", "b"), ("c", "b"), ("c", "d"), ("b", "d")]
    assert errors(rig, optimise_network(perturb_network(network(rig, "a", ring, noise=0.0)))).max() < 1e-6


def test_two_cameras_and_trees_have_nothing_to_optimise(rig):
    for links in ([("a", "b")], [("a", "b"), ("c", "b"), ("c", "d")]):
        chained = network(rig, "a", links)
        found = optimise_network(chained)
        assert found.cam_from_core is chained.cam_from_core
        assert found.path_errors == found.loop_errors == ()


@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_derivatives_equal_numeric_ones_of_the_residuals(rig, scale):
    """Also far from agreement, where the logarithm's own Jacobian counts."""
    own = perturb_network(network(rig, "b", combinations("abcd", 2), noise=scale))
    problem = NetworkProblem("b", tuple(own.cam_from_core), constraints(own, NetworkWeights(1.0, 0.3)))
    state = own.cam_from_core

    def residual(step):
        moved = problem.apply_step(state, step)
        return np.concatenate([c.compute_residual(moved) for c in problem.constraints])

    jacobian = problem.linearise(state).jacobian
    assert jacobian.shape == (6 * (6 + 3 * 4), 6 * 3)
    for column, size in enumerate(np.tile(np.repeat([1e-6, 1e-3], 3), 3)):
        step = np.zeros(18)
        step[column] = size
        numeric = (residual(step) - residual(-step)) / (2 * size)
        np.testing.assert_allclose(jacobian[:, column], numeric, atol=1e-6 * np.abs(jacobian).max())


@pytest.mark.thorough
def test_with_noise_the_optimum_is_more_accurate_than_the_chain_through_the_core():
    """Over 40 seeds, five cameras, independent pairs: half the error (docs/explanation/calibration.md states it)."""
    rig = row_of_cameras(list("abcde"))
    networks = [network(rig, "c", combinations("abcde", 2), seed) for seed in range(40)]
    chained = np.sqrt(np.mean([errors(rig, n) ** 2 for n in networks], axis=(0, 1)))
    optimised = np.sqrt(np.mean([errors(rig, optimise_network(n)) ** 2 for n in networks], axis=(0, 1)))
    assert (chained / optimised > 1.7).all()


def test_more_precise_pairs_have_more_weight(rig):
    """Two chains lead to c; the direct one is 100 times better in σ, so the other does not affect it."""
    rng = np.random.default_rng(3)
    poor = [make_noisy_pair(rig, *link, rng) for link in (("a", "b"), ("b", "c"))]
    good = make_noisy_pair(rig, "a", "c", rng, noise=0.0)
    found = optimise_network(
        associate_cameras("a", [*poor, replace(good, covariance=good.covariance / 1e4)]), NetworkWeights(1, 0)
    )
    moved = log(found.cam_from_core["c"] @ rig.relative_pose("a", "c"))
    assert (np.abs(moved) < 2e-3 * np.diag(UNITS)).all()


def test_the_minimum_does_not_depend_on_the_damping(rig):
    start = perturb_network(network(rig, "b", combinations("abcd", 2)))
    ends = [
        optimise_network(start, damping=damping)
        for damping in (
            None,
            Damping(start=10.0, tolerance=1e-14),
            Damping(high=0.9, low=0.1, tolerance=1e-14),
        )
    ]
    for end in ends[1:]:
        for name, pose in end.cam_from_core.items():
            np.testing.assert_allclose(
                pose.translation_mm, ends[0].cam_from_core[name].translation_mm, atol=1e-4
            )


@pytest.mark.thorough
def test_misclosures_before_and_after_agree_with_their_covariance():
    rig = row_of_cameras(list("abcd"))
    chi2 = {"before": [], "after": [], "loops": []}
    for seed in range(40):
        found = optimise_network(network(rig, "b", combinations("abcd", 2), seed))
        chi2["before"] += [e.chi2_per_dof for e in require(found.initial).path_errors]
        chi2["after"] += [e.chi2_per_dof for e in found.path_errors]
        chi2["loops"] += [e.chi2_per_dof for e in found.loop_errors]
    assert [len(v) // 40 for v in chi2.values()] == [3, 6, 4]  # steps of paths agree by construction
    for values in chi2.values():
        assert np.mean(values) == pytest.approx(1.0, abs=0.15)
