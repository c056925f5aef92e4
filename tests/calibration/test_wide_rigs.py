"""Rigs of wide lenses: a model is chosen without blaming the cameras, and nothing beyond a lens's domain is used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.calibration.assessment.cross_validation import cross_validate
from beltscape.calibration.assessment.findings import list_network_findings
from beltscape.calibration.assessment.lens_domain import limit_domains
from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections, Corners, drop_beyond_domains
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.core.errors import CalibrationError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.kernels import load
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.pairwise.rectification import rectify_pair
from beltscape.stereo.settings import MultiviewSettings
from tests.stereo.scenes import DEPTH_MM, make_ring, plane, quantise, render_images
from tests.synthetic.boards import board_poses, row_of_cameras
from tests.synthetic.detections import make_detections
from tests.thorough import examples

LENSES = {
    "rational": (280.0, [0.9, 0.2, 3e-4, -2e-4, 0.01, 1.25, 0.45, 0.05]),
    "fisheye": (200.0, [0.02, -0.01, 0.003, -0.001]),
    "brown": (520.0, [-0.35, 0.12, 3e-4, -2e-4, 0.0]),
}
NOISE_PX = 0.03


def widen(rig: Rig, model: str, reach_px: float | None = None, scale: float = 1.0) -> Rig:
    """Return the rig with lenses of a model, known up to a distance from the principal point."""
    focal, lens = LENSES[model]
    cameras = {
        name: Camera(
            name, each.size_px, np.full(2, scale * focal), each.center_px, np.array(lens), model, reach_px
        )
        for name, each in rig.cameras.items()
    }
    return replace(rig, cameras=cameras)


def see_boards(model: str, board) -> BoardDetections:
    """Return the corners of boards all over the view of two cameras with wide lenses."""
    rig = widen(row_of_cameras(["a", "b"], 90.0, 450.0), model)
    poses = [pose for x in (-130.0, 0.0, 150.0) for pose in board_poses(board, 7, 290.0, x_mm=x)]
    return make_detections(rig, board, poses, NOISE_PX)


@pytest.mark.thorough
def test_a_wide_rig_holds_out_at_the_noise_and_blames_no_camera(board):
    seen = see_boards("rational", board)
    hierarchy = solve_hierarchy(seen, board, "a", Silent())
    found = {name: camera.model for name, camera in hierarchy.rig.cameras.items()}
    assert list_network_findings(hierarchy) == []
    held_out = cross_validate(seen, board, "a", load(), lens_models=found)
    assert held_out is not None
    assert held_out.score.rms_px == pytest.approx(np.sqrt(2) * NOISE_PX, rel=0.15)
    adjustment = adjust_bundle(hierarchy, board)
    for name, camera in limit_domains(adjustment.rig, adjustment).cameras.items():
        corners = np.concatenate([view.pixels for view in seen.views[name].values()])
        assert np.isfinite(camera.undistort(corners)).mean() > 0.995
        assert camera.model == "brown" or camera.valid_radius_px is not None


def test_a_wide_rig_as_brown_ends_in_one_line_or_a_rig(board):
    """The polynomial turns back before the farthest corners of a fisheye, which have no ray."""
    seen = see_boards("fisheye", board)
    try:
        hierarchy = solve_hierarchy(seen, board, "a", Silent(), lens_models={"a": "brown", "b": "brown"})
        rig = adjust_bundle(hierarchy, board).rig
    except CalibrationError as error:
        assert "\n" not in str(error)
    else:
        assert all(np.isfinite(camera.distortion).all() for camera in rig.cameras.values())


@pytest.mark.parametrize("model", LENSES)
@given(reach_px=st.floats(60, 320), seed=st.integers(0, 10_000))
@examples(20)
def test_no_pixel_beyond_the_domain_is_projected_to_or_measured_from(model, reach_px, seed):
    camera = widen(row_of_cameras(["a"]), model, reach_px).cameras["a"]
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(-50, 550, (200, 2))
    radius = np.linalg.norm(pixels - camera.center_px, axis=1)
    known = np.isfinite(camera.undistort(pixels)[:, 0])
    tolerance_px = 0.02 * reach_px  # tangential terms shift the circle
    assert not known[radius > reach_px + tolerance_px].any()
    projected = camera.project(rng.uniform([-900, -900, 50], [900, 900, 900], (300, 3)))
    far = np.linalg.norm(projected - camera.center_px, axis=1)
    assert not (far > reach_px + tolerance_px).any()
    own = Corners(np.arange(200), pixels)
    kept = drop_beyond_domains(detect_one(camera, own), {"a": camera}).views["a"]
    assert sum(len(view) for view in kept.values()) in (int(known.sum()), 0)


def detect_one(camera: Camera, corners: Corners) -> BoardDetections:
    return BoardDetections({"a": camera.size_px}, {"a": {"00": corners}}, {"a": 1})


def test_corners_beyond_the_domain_of_given_lenses_do_not_matter(board):
    rig = widen(row_of_cameras(["a", "b"], 90.0, 450.0), "rational", 150.0)
    unlimited = widen(row_of_cameras(["a", "b"], 90.0, 450.0), "rational")
    poses = board_poses(board, 10, 380.0, x_mm=40.0)
    clean = make_detections(unlimited, board, poses, NOISE_PX)
    views = {
        name: {f: spoil(c, rig.cameras[name]) for f, c in own.items()} for name, own in clean.views.items()
    }
    found = [
        adjust_bundle(
            solve_hierarchy(drop_beyond_domains(seen, rig.cameras), board, "a", Silent(), known=rig.cameras),
            board,
        )
        for seen in (clean, replace(clean, views=views))
    ]
    assert any((views["a"][f].pixels != c.pixels).any() for f, c in clean.views["a"].items())
    first, second = (each.rig.cam_from_core["b"] for each in found)
    np.testing.assert_array_equal(first.translation_mm, second.translation_mm)
    np.testing.assert_array_equal(first.rotation, second.rotation)


def spoil(corners: Corners, camera: Camera) -> Corners:
    """Return the corners, those beyond the domain moved outwards by 9 px."""
    off = corners.pixels - camera.center_px
    beyond = np.isnan(camera.undistort(corners.pixels)[:, :1])
    return replace(
        corners, pixels=corners.pixels + np.where(beyond, 9 * off / np.linalg.norm(off, axis=1)[:, None], 0)
    )


@pytest.mark.parametrize("model", LENSES)
def test_rectification_takes_no_pixel_beyond_the_domain(model):
    rig = widen(make_ring((0,)), model, 45.0, scale=0.25)
    pair = rectify_pair(rig, "cam1", (600.0, 800.0))
    for camera, source in ((rig.core_camera, pair.core_map), (rig.cameras["cam1"], pair.aux_map)):
        radius = np.linalg.norm(source - camera.center_px, axis=-1)
        inside = (source >= 0).all(axis=-1) & (source <= np.array(camera.size_px) - 1).all(axis=-1)
        assert inside.sum() > 500
        assert not (radius[inside] > 45.5).any()


@pytest.mark.parametrize("model", LENSES)
def test_reconstruction_takes_and_gives_no_pixel_beyond_the_domain(model):
    """Noise beyond the domain, and the pixels that windows and pyramids join with it, changes no depth within."""
    reach_px, margin_px = 42.0, 6.0
    rig = widen(make_ring(), model, reach_px, scale=0.25)
    images = render_images(widen(make_ring(), model, scale=0.25), (plane(),))
    clean = {name: quantise(np.nan_to_num(image, nan=90.0)) for name, image in images.items()}
    depth = reconstruct(rig, clean)
    core = rig.core_camera
    source = core.distort(core.rays()) * core.focal_px + core.center_px
    radius = np.linalg.norm(source - core.center_px, axis=-1)
    assert np.isnan(depth[~(radius <= reach_px + 0.5)]).all()
    inner = radius < reach_px - margin_px
    assert np.isfinite(depth[inner]).mean() > 0.9
    assert np.nanmedian(np.abs(depth[inner] - DEPTH_MM)) < 0.5
    spoilt = {
        name: spoil_image(image, rig.cameras[name], reach_px + margin_px) for name, image in clean.items()
    }
    change = np.abs(reconstruct(rig, spoilt) - depth)[inner]
    assert np.nanquantile(change, 0.95) < 0.05


def reconstruct(rig: Rig, images: dict[str, np.ndarray]) -> np.ndarray:
    matcher = MultiviewReconstructor(rig, (600.0, 800.0), MultiviewSettings(threads=1))
    return matcher.reconstruct(FrameSet("000", images), Silent()).depth_mm


def spoil_image(image: np.ndarray, camera: Camera, radius_px: float) -> np.ndarray:
    """Return the image with noise beyond a radius from the principal point."""
    rows, columns = np.indices(image.shape)
    far = np.hypot(columns - camera.center_px[0], rows - camera.center_px[1]) > radius_px
    noise = np.random.default_rng(3).integers(0, 255, image.shape).astype(image.dtype)
    return np.where(far, noise, image)
