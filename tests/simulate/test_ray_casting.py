"""Exact ray casting, compared with analytic surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.simulate.core_truth import compute_pixel_rays, is_in_image
from beltscape.simulate.ray_casting import RayScene
from beltscape.simulate.shapes import Mesh, make_box, make_cylinder, make_sphere, triangulate_height_field
from beltscape.simulate.world import Solid
from tests.strategies import cameras, poses, seeds
from tests.thorough import examples

LENS = Camera(
    "cam0", (200, 160), np.array([190.0, 191.0]), np.array([101.3, 78.8]),
    np.array([-0.07, 0.09, 4e-4, -1e-4, 0.0]),
)  # fmt: skip
DOWN = Pose(np.diag([1.0, -1, -1]), np.array([3.0, -5.0, 700.0]))


def solid(mesh: Mesh, label: int = 2) -> Solid:
    return Solid("solid", label, mesh.vertices_mm, mesh.faces, (0.5, 0.5, 0.5))


def make_ground(z: float = 0.0) -> Mesh:
    ends = np.array([-2000.0, 2000.0])
    return triangulate_height_field(ends, ends, np.full((2, 2), z))


def tilted() -> Pose:
    """cam_from_world: 700 mm above the origin, turned a little about every axis."""
    turn = Pose.of([0.06, -0.08, 0.3], np.zeros(3))
    return turn @ DOWN


@examples(25)
@given(camera=cameras(), pose=poses(), seed=seeds)
def test_points_are_projected_as_opencv_projects_them(camera, pose, seed):
    import cv2

    xy = np.random.default_rng(seed).uniform(-0.3, 0.3, (50, 2))
    points = np.column_stack([xy, np.ones(50)]) * np.linspace(300, 900, 50)[:, None]
    theirs, _ = cv2.projectPoints(
        points @ pose.rotation - pose.rotation.T @ pose.translation_mm, pose.rotation_vector,
        pose.translation_mm, camera.matrix, camera.distortion,
    )  # fmt: skip
    ours = camera.project(pose.apply(points @ pose.rotation - pose.rotation.T @ pose.translation_mm))
    np.testing.assert_allclose(ours, theirs[:, 0], atol=1e-6)


@pytest.mark.parametrize("distorted", [False, True])
def test_depth_of_a_plane_is_exact(distorted):
    pose = tilted()
    rays = compute_pixel_rays(LENS, pose, distorted=distorted)
    hits = RayScene([solid(make_ground(12.0))]).cast(pose.center_mm, rays)
    expected = (12.0 - pose.center_mm[2]) / rays[:, 2]
    np.testing.assert_allclose(hits.distance, expected, rtol=0, atol=1e-9)
    points = pose.center_mm + hits.distance[:, None] * rays
    np.testing.assert_allclose(pose.apply(points)[:, 2], hits.distance, atol=1e-9)  # a distance is a depth
    pixels = np.indices((160, 200))[::-1].reshape(2, -1).T
    seen = LENS.project(pose.apply(points)) if distorted else _pinhole(pose.apply(points))
    np.testing.assert_allclose(seen, pixels, atol=1e-9)


def _pinhole(points):
    return points[:, :2] / points[:, 2:] * LENS.focal_px + LENS.center_px


def test_depth_of_a_sphere_matches_the_exact_sphere():
    pose, middle, radius = tilted(), np.array([20.0, -30, 35]), 35.0
    rays = compute_pixel_rays(LENS, pose, distorted=True)
    hits = RayScene([solid(make_sphere(radius).transform(Pose(np.eye(3), middle)))]).cast(
        pose.center_mm, rays
    )
    o = pose.center_mm - middle
    a, b, c = (rays**2).sum(1), rays @ o, o @ o - radius**2
    root = b * b - a * c
    chord = np.sqrt(np.maximum(root, 0) / a)  # mm, half of what lies within the sphere
    full = chord > 6  # a graze turns a micrometre across into many along
    assert full.sum() > 100
    expected = (-b - np.sqrt(np.maximum(root, 0))) / a
    assert np.abs(hits.distance - expected)[full].max() < 0.005
    assert np.median(np.abs(hits.distance - expected)[full]) < 0.001
    assert np.isinf(hits.distance[root < -1e3]).all()


def test_depth_of_a_box_is_exact():
    pose = tilted()
    low, high = np.array([-40.0, -30, 0]), np.array([40.0, 30, 60])
    rays = compute_pixel_rays(LENS, pose, distorted=True)
    hits = RayScene([solid(make_box([80, 60, 60]))]).cast(pose.center_mm, rays)
    one, two = (low - pose.center_mm) / rays, (high - pose.center_mm) / rays
    enter, leave = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
    expected = np.where(enter <= leave, enter, np.inf)
    assert np.isfinite(expected).sum() > 400
    np.testing.assert_array_equal(np.isfinite(hits.distance), np.isfinite(expected))
    met = np.isfinite(expected)
    np.testing.assert_allclose(hits.distance[met], expected[met], rtol=0, atol=1e-9)


def test_depth_of_a_cylinder_matches_the_exact_cylinder():
    pose = tilted()
    rays = compute_pixel_rays(LENS, pose, distorted=True)
    foot = np.array([150.0, 100, 0])
    hits = RayScene([solid(make_cylinder(30.0, 90.0).transform(Pose(np.eye(3), foot)))]).cast(
        pose.center_mm, rays
    )
    o = pose.center_mm - foot
    a = (rays[:, :2] ** 2).sum(1)
    b, c = rays[:, :2] @ o[:2], o[:2] @ o[:2] - 900
    root = b * b - a * c
    side = (-b - np.sqrt(np.maximum(root, 0))) / a
    z = o[2] + side * rays[:, 2]
    top = (90 - o[2]) / rays[:, 2]
    distance = np.linalg.norm(o[:2] + top[:, None] * rays[:, :2], axis=1)
    on_top, on_side = distance < 29.99, (root > 2.0) & (z > 0.1) & (z < 89.9) & (distance > 30.01)
    assert on_top.sum() > 100
    assert on_side.sum() > 30
    np.testing.assert_allclose(hits.distance[on_top], top[on_top], rtol=0, atol=1e-9)
    # along the ray a micrometre of radius is as much more as the ray is steep
    steep = np.abs(rays[:, 2]) / np.abs((o[:2] + side[:, None] * rays[:, :2]) / 30 * rays[:, :2]).sum(axis=1)
    assert (np.abs(hits.distance - side) / np.maximum(steep, 1))[on_side].max() < 0.005


@examples(15)
@given(seed=seeds)
def test_nearest_of_random_triangles_is_hit_as_in_float64(seed):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-200, 200, (60, 1, 3)) + rng.uniform(-90, 90, (60, 3, 3))
    soup = Mesh(corners.reshape(-1, 3), np.arange(180).reshape(-1, 3))
    eye = rng.uniform([-100, -100, 500], [100, 100, 700])
    rays = rng.uniform(-200, 200, (400, 3)) - eye
    found = RayScene([solid(soup)]).cast(eye, rays)
    a, b, c = np.moveaxis(corners, 1, 0)
    # of each ray and face: signs of the volumes between ray and edges; where the ray crosses the plane
    normal = np.cross(b - a, c - a)
    t = ((a - eye) * normal).sum(axis=1) / (rays @ normal.T)
    sides = [((eye - p) * np.cross(q - p, rays[:, None])).sum(axis=2) for p, q in ((a, b), (b, c), (c, a))]
    inside = np.all([side > 0 for side in sides], axis=0) | np.all([side < 0 for side in sides], axis=0)
    t = np.where(inside & (t > 0), t, np.inf)
    np.testing.assert_allclose(found.distance, t.min(axis=1), rtol=1e-12)
    met = np.isfinite(found.distance)
    assert met.sum() > 50
    np.testing.assert_array_equal(found.face[met], t.argmin(axis=1)[met])


def test_no_ray_passes_between_triangles_and_the_nearer_of_two_close_surfaces_is_hit():
    x = np.linspace(-50, 50, 101)
    flat = triangulate_height_field(x, x, np.zeros((101, 101)))
    above = triangulate_height_field(x, x, np.full((101, 101), 1e-3))
    scene = RayScene([solid(flat, 1), solid(above, 2)])
    rng = np.random.default_rng(2)
    nodes = rng.integers(-49, 50, (4000, 2)).astype(float)
    nodes[::2, 0] += 0.5  # half of the rays through nodes, half through edges
    targets = np.column_stack([nodes, np.full(4000, 1e-3)])
    eye = np.array([120.0, -80.0, 500.0])
    hits = scene.cast(eye, targets - eye)
    np.testing.assert_allclose(hits.distance, 1.0, rtol=0, atol=1e-12)
    assert (scene.label_of_face[hits.face] == 2).all()


def test_ray_with_nan_hits_nothing():
    hits = RayScene([solid(make_ground())]).cast(
        np.array([0.0, 0, 9]), np.array([[np.nan, 0, -1], [0, 0, -1.0]])
    )
    assert np.isinf(hits.distance[0])
    assert hits.distance[1] == pytest.approx(9)
    assert hits.face[0] == -1
    nowhere = RayScene([solid(make_ground())]).cast(np.zeros(3), np.full((2, 3), np.nan))
    assert np.isinf(nowhere.distance).all()


def test_wall_hides_what_is_behind_it():
    scene = RayScene([solid(make_ground()), solid(make_box([10.0, 400, 50]))])
    eye = np.array([100.0, 0, 100])
    x = np.array([60.0, -20, -94, -96, -150])  # the shadow of the wall's top edge at x = -5 … ends at -110
    points = np.column_stack([x, np.zeros(5), np.zeros(5)])
    up = np.tile([0.0, 0, 1], (5, 1))
    edge = 100 - 105 * 100 / 50
    np.testing.assert_array_equal(scene.is_visible_from(points, up, eye), (x > 0) | (x < edge))
    assert not scene.is_visible_from(points, -up, eye).any()


@examples(20)
@given(seed=seeds)
def test_convex_body_is_visible_where_it_faces_the_eye(seed):
    rng = np.random.default_rng(seed)
    ball = make_sphere(20.0, 0.1)
    scene = RayScene([solid(ball)])
    eye = rng.normal(size=3)
    eye *= rng.uniform(40, 900) / np.linalg.norm(eye)
    faces = np.arange(len(ball.faces))
    points, normals = scene.corners_mm.mean(axis=1), scene.face_normals(faces)
    facing = ((eye - points) * normals).sum(axis=1) > 0
    np.testing.assert_array_equal(scene.is_visible_from(points, normals, eye), facing)


def test_points_far_outside_the_view_are_not_in_the_image():
    folding = Camera(
        "fold", (200, 160), np.full(2, 190.0), np.array([99.5, 79.5]), np.array([-0.3, 0, 0, 0, 0.0])
    )
    x = np.linspace(-3000, 3000, 401)
    points = np.column_stack([x, np.zeros(401), np.zeros(401)])
    seen = is_in_image(folding, DOWN, points)
    ideal = DOWN.apply(points)[:, :2] / DOWN.apply(points)[:, 2:]
    folded = (
        folding.lens.distort(ideal[:, 0], ideal[:, 1], folding.distortion)[0] * 190
    )  # beyond the lens's domain, too
    assert (np.abs(folded) < 50).sum() > (seen & (np.abs(folded) < 50)).sum()
    assert np.abs(x[seen]).max() < 700
    assert seen[np.abs(x) < 250].all()
