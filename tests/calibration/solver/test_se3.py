"""The Lie group SE(3): exponential, logarithm, adjoint and Jacobians."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from beltscape.calibration.network.pose_chains import (
    adjoint,
    exp,
    left_jacobian,
    left_jacobian_inverse,
    log,
    skew,
    small_adjoint,
)

SCALE = np.repeat([1.0, 1000.0], 3)
"""Radians and mm, brought to the same size."""


@st.composite
def twists(draw, max_angle: float = np.pi - 1e-9):
    axis = np.array(draw(st.tuples(*[st.floats(-1, 1)] * 3)))
    axis = axis / np.linalg.norm(axis) if np.linalg.norm(axis) > 1e-3 else np.array([0.0, 0.6, 0.8])
    special = st.sampled_from(
        [0.0, 1e-12, 1e-8, 1e-4, 9.99e-3, 1e-2, 0.999, 1.0, max_angle, max_angle - 1e-6]
    )
    angle = min(draw(special | st.floats(0, max_angle)), max_angle)
    shift = np.array(draw(st.tuples(*[st.floats(-2000, 2000)] * 3)))
    return np.concatenate([axis * angle, shift])


def matrix(pose):
    return np.block([[pose.rotation, pose.translation_mm[:, None]], [np.zeros((1, 3)), 1.0]])  # pyrefly: ignore[no-matching-overload]


@given(twists())
def test_log_undoes_exp(twist):
    np.testing.assert_allclose(log(exp(twist)) / SCALE, twist / SCALE, atol=3e-7)


@given(twists(max_angle=3.0))
def test_away_from_half_a_turn_log_undoes_exp_to_the_last_digits(twist):
    np.testing.assert_allclose(log(exp(twist)) / SCALE, twist / SCALE, atol=1e-12)


@given(twists())
def test_exp_undoes_log(twist):
    pose = exp(twist)
    np.testing.assert_allclose(matrix(exp(log(pose))), matrix(pose), atol=1e-9)


@given(twists())
def test_exp_is_the_matrix_exponential(twist):
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = skew(twist[:3]), twist[3:]
    np.testing.assert_allclose(matrix(exp(twist)), expm(generator), atol=1e-9)


@given(twists(), twists())
def test_the_adjoint_brings_a_twist_to_the_other_side(pose, twist):
    moved = exp(pose)
    np.testing.assert_allclose(
        matrix(moved @ exp(twist)) / 1000, matrix(exp(adjoint(moved) @ twist) @ moved) / 1000, atol=1e-9
    )


@given(twists())
def test_the_adjoint_is_the_exponential_of_the_small_one(twist):
    np.testing.assert_allclose(adjoint(exp(twist)), expm(small_adjoint(twist)), atol=1e-8)


@given(twists())
def test_the_left_jacobian_is_the_integral_of_the_adjoint(twist):
    augmented = np.zeros((12, 12))  # expm([[ad, I], [0, 0]]) holds the integral of expm(s ad) over s in 0..1
    augmented[:6, :6], augmented[:6, 6:] = small_adjoint(twist), np.eye(6)
    np.testing.assert_allclose(left_jacobian(twist), expm(augmented)[:6, 6:], atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.3, 0.999, 1.001, 3.0])
def test_the_inverse_jacobian_is_the_derivative_of_log(angle):
    twist = np.array([0.6 * angle, 0.0, -0.8 * angle, 120.0, -40.0, 300.0])
    steps = np.diag(np.repeat([1e-6, 1e-3], 3))
    left = [(log(exp(d) @ exp(twist)) - log(exp(-d) @ exp(twist))) / (2 * d.sum()) for d in steps]
    np.testing.assert_allclose(left_jacobian_inverse(twist), np.transpose(left), rtol=1e-6, atol=1e-5)
