"""Rigid transforms: products, inverses and their laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from beltscape.core.errors import ArgumentError
from beltscape.core.geometry.pose import Pose, is_rotation, rotation_from_vector, vector_from_rotation
from tests.strategies import ANGLES, poses, rotation_vectors, vectors


def same(a: Pose, b: Pose) -> None:
    np.testing.assert_allclose(a.rotation, b.rotation, atol=1e-14)
    np.testing.assert_allclose(a.translation_mm, b.translation_mm, atol=1e-10)


@given(poses(), poses())
def test_a_product_of_poses_is_a_pose(a, b):
    rotation = (a @ b).rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-13)


@given(poses())
def test_identity_changes_nothing(a):
    same(Pose.identity() @ a, a)
    same(a @ Pose.identity(), a)


@given(poses())
def test_inverse_undoes_from_both_sides(a):
    same(a @ a.inverse(), Pose.identity())
    same(a.inverse() @ a, Pose.identity())


@given(poses(), poses(), poses())
def test_products_associate(a, b, c):
    same((a @ b) @ c, a @ (b @ c))


@given(poses(), poses(), vectors(3, 2000.0))
def test_a_product_applies_its_right_factor_first(a, b, point):
    np.testing.assert_allclose((a @ b).apply(point), a.apply(b.apply(point)), atol=1e-9)


@given(poses())
def test_apply_takes_batches_of_any_shape(a):
    points = np.arange(24.0).reshape(2, 4, 3)
    one_by_one = [[a.apply(point) for point in row] for row in points]
    np.testing.assert_allclose(a.apply(points), one_by_one, atol=1e-10)


@given(poses())
def test_the_centre_is_what_the_pose_brings_to_the_origin(a):
    np.testing.assert_allclose(a.apply(a.center_mm), np.zeros(3), atol=1e-9)


@given(rotation_vectors())
def test_rotation_vectors_give_rotations(vector):
    rotation = rotation_from_vector(vector)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-13)


@given(rotation_vectors())
def test_rotation_vectors_agree_with_opencv(vector):
    import cv2

    np.testing.assert_allclose(rotation_from_vector(vector), cv2.Rodrigues(vector)[0], atol=1e-14)


@given(rotation_vectors())
def test_rotation_through_its_vector_is_unchanged(vector):
    rotation = rotation_from_vector(vector)
    np.testing.assert_allclose(rotation_from_vector(vector_from_rotation(rotation)), rotation, atol=1e-14)


@given(rotation_vectors())
def test_rotation_vectors_survive_the_round_trip(vector):
    back = vector_from_rotation(rotation_from_vector(vector))
    if np.linalg.norm(vector) > np.pi - 1e-7 and back @ vector < 0:
        back = -back  # a half turn has two vectors
    np.testing.assert_allclose(back, vector, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("angle", ANGLES)
def test_angle_is_in_degrees(angle):
    pose = Pose.of(np.array([0.6, 0.0, -0.8]) * angle, [0, 0, 0])
    assert pose.angle_deg == pytest.approx(np.rad2deg(angle), rel=1e-12, abs=1e-12)


def test_poses_are_made_from_lists():
    pose = Pose.of([0, 0, np.pi / 2], [1, 2, 3])
    np.testing.assert_allclose(pose.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)
    np.testing.assert_allclose(pose.apply(np.array([1.0, 0, 0])), [1, 3, 3])
    same(Pose.of(pose.rotation.tolist(), (1, 2, 3)), pose)


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([1.0, 1.0, -1.0]),
        np.eye(3)[[1, 0, 2]],
        np.diag([1.0, 1.0, 1 + 1e-6]),
        np.array([[1, 1e-5, 0], [0, 1, 0], [0, 0, 1]]),
    ],
    ids=["mirror", "exchanged axes", "stretched", "sheared"],
)
def test_what_is_no_rotation_is_refused(matrix):
    assert not is_rotation(matrix)
    with pytest.raises(ArgumentError, match="rotation is no rotation"):
        Pose(matrix, np.zeros(3))
