"""Rendered images: geometry, light and depth agree."""

from __future__ import annotations

import cv2
import drjit
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from beltscape.core.errors import InputError
from beltscape.core.geometry.pose import Pose
from beltscape.simulate.rendering.optics import Optics
from beltscape.simulate.rendering.render import RenderSettings, render, resolve_engine
from beltscape.simulate.world import World
from tests.synthetic.light import DOWN, camera, plane, projector, station
from tests.thorough import THOROUGH, list_cases

SCALAR = RenderSettings(engine="scalar")
FINE = RenderSettings(engine="scalar", oversample=4, passes=5 if THOROUGH else 3)
LLVM = pytest.mark.skipif(resolve_engine("auto") != "llvm", reason="optional: needs LLVM 19")
both_engines = pytest.mark.parametrize("engine", ["scalar", pytest.param("llvm", marks=LLVM)])
TILTED = Pose.of([np.pi + 0.12, 0.05, 0.06], [15, -10, 690])


def by(engine, settings=SCALAR):
    return settings.model_copy(update={"engine": engine})


def picture(world, cam=None, pose=DOWN, settings=SCALAR, optics=None):
    cam = cam or camera()
    return render(world, station(cam, poses=(pose,)), {cam.name: optics or Optics()}, settings)[cam.name]


def chessboard(columns=13, rows=10, square_mm=30.0):
    squares = (np.indices((rows, columns)).sum(axis=0) % 2).astype(np.float32) * 0.8 + 0.1
    texture = np.repeat(squares[..., None], 3, axis=-1)
    x = (np.arange(1, columns) - columns / 2) * square_mm
    y = (rows / 2 - np.arange(1, rows)) * square_mm
    corners = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    board = plane(columns * square_mm, rows * square_mm, texture=texture)
    return board, np.column_stack([corners, np.zeros(len(corners))])


def smooth_noise(rng, shape, sigma=2.0):
    blurred = cv2.GaussianBlur(rng.standard_normal(shape).astype(np.float32), (0, 0), sigma)
    return np.clip(0.5 + 0.2 * blurred / blurred.std(), 0.02, 1)


@both_engines
def test_corners_lie_where_the_camera_projects_them(engine):
    board, corners = chessboard()
    cam = camera(360, 300, focal=450.0)
    image = picture(World((board,), None), cam, TILTED, by(engine, FINE))
    true = cam.project(TILTED.apply(corners))
    grey = np.rint(image[..., 0] * 255).astype(np.uint8)
    start = true[:, None].astype(np.float32)
    found = cv2.cornerSubPix(grey, start.copy(), (6, 6), (-1, -1), (3, 100, 1e-5))[:, 0]
    error = found - true
    assert np.abs(error.mean(axis=0)).max() < 0.01
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.05


def shift_between(first, second):
    """Least-squares shift of the second image against the first, px."""
    by, bx = np.gradient(0.5 * (first + second))
    inner = (slice(8, -8), slice(8, -8))
    slopes = np.column_stack([bx[inner].ravel(), by[inner].ravel(), np.ones(bx[inner].size)])
    found, *_ = np.linalg.lstsq(slopes, (first - second)[inner].ravel(), rcond=None)
    return found[:2]


@pytest.mark.thorough
@both_engines
def test_image_warped_by_true_depth_has_no_shift(engine, seed=3):
    """An auxiliary's light, fetched through the plane's true depth and both exact distortions."""
    rng = np.random.default_rng(seed)
    texture = np.repeat(smooth_noise(rng, (400, 500))[..., None], 3, axis=-1)
    surface = plane(640, 512, texture=texture)
    core, other = camera(), camera(distortion=(-0.06, 0.05, -3e-4, 2e-4, 0.0), name="cam1")
    # the other camera is shifted to the side: the same depth, so that neither scale nor blur differ
    poses = (DOWN, Pose(np.eye(3), np.array([60.3, -20.2, 0.0])) @ DOWN)
    rig = station(core, other, poses=poses)
    images = render(
        World((surface,), None),
        rig,
        {"cam0": Optics(psf_sigma_px=1.2), "cam1": Optics(psf_sigma_px=1.2)},
        RenderSettings(engine=engine, oversample=3, passes=5 if THOROUGH else 3, texture_filter="bilinear"),
    )
    pixels = np.stack(np.meshgrid(np.arange(60, 190), np.arange(50, 150)), axis=-1)
    rays = core.undistort(pixels)
    points = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1) * 700
    seen = other.project(poses[1].apply(poses[0].inverse().apply(points)))
    # a quintic spline: OpenCV's remap would round places to 1/32 px
    warped = map_coordinates(images["cam1"][..., 0].astype(float), [seen[..., 1], seen[..., 0]], order=5)
    shift = shift_between(images["cam0"][50:150, 60:190, 0], warped)
    assert np.abs(shift).max() < 0.001


@both_engines
@pytest.mark.parametrize("center", list_cases([None, (95.3, 41.8)], [(95.3, 41.8)]))
def test_projected_dot_appears_where_the_projector_projects_it(center, engine):
    pose = Pose.of([np.pi - 0.08, 0.06, 0.03], [20, -15, 720])
    rows, columns = np.mgrid[:100, :160]
    dots = np.array([[40.0, 30.0], [111.4, 27.7], [37.3, 71.6], [118.0, 68.5]])
    pattern = sum(np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / (2 * 2.0**2)) for u, v in dots)
    light = projector(pattern, focal=(260.0, 264.0), center=center, pose=pose)
    cam = camera(200, 162, focal=212.5, distortion=(0.0,) * 5)
    image = picture(World((plane(900, 900),), light, ambient=0.0), cam, settings=by(engine, FINE))[..., 0]
    # Each dot's light by where it came from. The camera's pixels are of one size on the plane, so that their
    # light is the projector's light through each part of the pattern.
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    rays = cam.undistort(np.stack([u, v], axis=-1))
    points = DOWN.inverse().apply(np.concatenate([rays * 700, np.full((*u.shape, 1), 700.0)], axis=-1))
    at = light.camera.project(pose.apply(points))
    for dot in dots:
        near = np.linalg.norm(at - dot, axis=-1) < 10
        mean = (at[near] * image[near, None]).sum(axis=0) / image[near].sum()
        assert np.abs(mean - dot).max() < 0.002


@both_engines
def test_ambient_light_of_one_makes_white_one(engine):
    image = picture(World((plane(900, 900, colour=0.5),), None, ambient=1.0), settings=by(engine))
    np.testing.assert_allclose(image, 0.5, rtol=1e-4)


@both_engines
def test_projectors_power_is_that_of_a_white_pixel_at_a_metre(engine):
    light = projector(
        np.ones((60, 80)), focal=(100.0, 100.0), pose=Pose.of([np.pi, 0, 0], [0, 0, 1000]), power=2.5
    )
    image = picture(World((plane(900, 900, colour=0.4),), light, ambient=0.0), settings=by(engine))
    np.testing.assert_allclose(image[60:140, 80:160], 1.0, rtol=2e-3)


@both_engines
def test_colours_keep_their_channels_and_sides(engine):
    texture = np.zeros((2, 2, 3), np.float32)
    texture[0, 0], texture[0, 1], texture[1, 0] = (1, 0, 0), (0, 1, 0), (0, 0, 1)
    image = picture(World((plane(texture=texture),), None), settings=by(engine))
    np.testing.assert_allclose(image[60, 90], (1, 0, 0), atol=1e-3)
    np.testing.assert_allclose(image[60, 160], (0, 1, 0), atol=1e-3)
    np.testing.assert_allclose(image[140, 90], (0, 0, 1), atol=1e-3)
    np.testing.assert_allclose(image[140, 160], 0, atol=1e-3)


def test_shadow_keeps_the_halls_light():
    side = Pose.of([0, 0.5, 0], [0, 0, 700]) @ Pose.of([np.pi, 0, 0], [0, 0, 0])
    light = projector(np.ones((60, 80)), focal=(40.0, 40.0), pose=side, power=1.0)
    board = plane(60, 60, z_mm=80, colour=0.5)
    image = picture(World((plane(900, 900, colour=0.5), board), light))[..., 0]
    unlit = picture(World((plane(900, 900, colour=0.5), board), None))[..., 0]
    shadowed = np.abs(image - unlit) < 1e-3
    assert 300 < shadowed.sum() < 3000
    assert (unlit[shadowed] > 0.1).all()


def test_blur_grows_with_the_distance_from_the_plane_in_focus():
    """Radius of the blur disc of a point: aperture/2 · |1/z - 1/focus| · f, variance r²/4 per axis."""
    small = camera(60, 50, distortion=(0.0,) * 5)
    spot = World((plane(4, 4, z_mm=100.0),), None)
    settings = RenderSettings(engine="scalar", oversample=3, passes=89 if THOROUGH else 60)
    variances = []
    for focus in (600.0, 700.0):
        optics = Optics(aperture_mm=40, focus_mm=focus)
        image = picture(spot, small, settings=settings, optics=optics)
        light = image[..., 0].sum(axis=0)
        columns = np.arange(len(light))
        middle = (light * columns).sum() / light.sum()
        assert middle == pytest.approx(small.center_px[0], abs=0.02)
        variances.append((light * (columns - middle) ** 2).sum() / light.sum())
    radius = 20 * abs(1 / 600 - 1 / 700) * 300
    assert variances[1] - variances[0] == pytest.approx(radius**2 / 4, rel=0.05)


@both_engines
def test_point_spread_has_the_requested_width(engine):
    cam = camera(distortion=(0.0,) * 5)
    spot = World((plane(7, 7),), None)
    light = picture(spot, cam, settings=by(engine, FINE), optics=Optics(psf_sigma_px=0.9))[..., 0].sum(axis=0)
    columns = np.arange(len(light))
    middle = (light * columns).sum() / light.sum()
    side_px = 7 * 300 / 700
    variance = (light * (columns - middle) ** 2).sum() / light.sum()
    assert variance == pytest.approx(0.9**2 + 1 / 12 + side_px**2 / 12, rel=0.01)


@both_engines
def test_vignetting_follows_the_power_of_the_cosine(engine):
    cam = camera(distortion=(0.0,) * 5)
    image = picture(World((plane(900, 900),), None), cam, settings=by(engine), optics=Optics(falloff=4))
    ray = (np.array([5.0, 7.0]) - cam.center_px) / cam.focal_px
    assert image[7, 5, 0] == pytest.approx((1 + ray @ ray) ** -2, rel=1e-3)


def test_gloss_adds_highlights():
    light, coarse = projector(np.ones((60, 80)), focal=(60.0, 60.0)), camera(120, 100, focal=150.0)
    matt, shiny = (
        picture(World((plane(900, 900, colour=0.1, gloss=gloss),), light, ambient=0.0), coarse)[..., 0]
        for gloss in (0.0, 0.5)
    )
    assert shiny.argmax() // 120 == pytest.approx(48, abs=12)
    assert shiny.max() > 1.5 * matt.max()
    assert (shiny >= matt - 1e-5).all()


def test_bounced_light_brightens_a_corner():
    wall = plane(400, 400, colour=0.8)
    vertices = wall.vertices_mm[:, [2, 1, 0]] * [1, 1, -1] + [50, 0, 200]
    upright = type(wall)("wall", wall.label, vertices, wall.faces, wall.reflectance)
    world = World((plane(900, 900, colour=0.8), upright), None)
    small = camera(120, 100, focal=150.0)
    once = picture(world, small)[40:60, 50:60].mean()
    often = picture(world, small, settings=RenderSettings(engine="scalar", bounces=2, passes=8))[
        40:60, 50:60
    ].mean()
    assert 1.05 * once < often < 1.5 * once


@both_engines
def test_same_seed_gives_the_same_bytes_for_any_number_of_threads(engine):
    rng = np.random.default_rng(0)
    light = projector(smooth_noise(rng, (60, 80)), focal=(60.0, 60.0))
    world = World((plane(900, 900, colour=0.5), plane(60, 60, z_mm=80, colour=0.7)), light)
    before, images = drjit.thread_count(), []
    try:
        for threads in (1, 3):
            drjit.set_thread_count(threads)
            images.append(picture(world, camera(120, 100, focal=150.0), settings=by(engine)))
    finally:
        drjit.set_thread_count(before)
    assert images[0].tobytes() == images[1].tobytes()


def test_seed_matters_only_to_the_halls_light():
    world = World((plane(900, 900, colour=0.5), plane(60, 60, z_mm=80, colour=0.7)), None)
    cam = camera()
    first, second = (
        render(world, station(cam), {"cam0": Optics()}, SCALAR, seed=seed)["cam0"] for seed in (0, 1)
    )
    assert 0 < np.abs(first - second).max() < 0.2


@LLVM
def test_both_engines_give_the_same_picture():
    rng = np.random.default_rng(0)
    light = projector(smooth_noise(rng, (60, 80)), focal=(60.0, 60.0))
    world = World((plane(900, 900, colour=0.5), plane(60, 60, z_mm=80, colour=0.7)), light)
    plain = picture(world, settings=RenderSettings(engine="scalar", ambient_samples=64))
    compiled = picture(world, settings=RenderSettings(engine="llvm", ambient_samples=64))
    assert np.abs(plain - compiled).max() < 0.1
    assert np.abs(plain - compiled).mean() < 2e-3


def test_camera_the_rig_does_not_have_is_refused():
    with pytest.raises(InputError, match="cam9"):
        render(World((plane(),), None), station(camera()), {"cam9": Optics()}, SCALAR)


def test_lens_that_folds_inside_the_image_is_refused():
    with pytest.raises(InputError, match="folds"):
        picture(World((plane(),), None), camera(distortion=(-3.0, 0, 0, 0, 0)))


def test_textured_solid_without_uv_is_refused():
    bare = plane(texture=np.ones((2, 2, 3), np.float32))
    bare = type(bare)(
        bare.name, bare.label, bare.vertices_mm, bare.faces, bare.reflectance, texture=bare.texture
    )
    with pytest.raises(InputError, match="uv"):
        picture(World((bare,), None))


def test_pattern_of_the_wrong_size_is_refused():
    light = projector(np.ones((60, 80)))
    wrong = type(light)(light.camera, light.projector_from_world, light.pattern[:50], light.power)
    with pytest.raises(InputError, match="shape"):
        picture(World((plane(),), wrong))
