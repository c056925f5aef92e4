"""Common numbering of the cameras' marker grids, and the depth bounds of regions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.kernels import load
from beltscape.stereo.markers.correspondence import align_grids, triangulate_markers
from beltscape.stereo.markers.grid import MarkerGrid, detect_marker_grid
from beltscape.stereo.markers.region_depths import bound_region_depths, detect_marker_grids
from tests.stereo.raycast import make_world_rig
from tests.stereo.rendered import needs_rendered, read_halved_frames, read_halved_rig, read_halved_truth

RNG = np.random.default_rng(8)
HEIGHTS_MM = RNG.uniform(0, 60, (4, 4))


def _place_markers(core_from_world) -> np.ndarray:
    """Return the (4, 4, 3) markers on relief, in the core's frame, mm."""
    x, y = np.meshgrid(np.linspace(-150, 150, 4), np.linspace(100, -100, 4))
    return core_from_world.apply(np.stack([x, y, HEIGHTS_MM], axis=-1))


def _make_scene() -> tuple[Rig, np.ndarray, dict[str, MarkerGrid]]:
    rig, core_from_world = make_world_rig()
    points = _place_markers(core_from_world)
    whole = np.ones((4, 4), bool)
    grids = {
        name: MarkerGrid(
            camera.size_px,
            camera.project(rig.cam_from_core[name].apply(points)),
            whole,
            np.full((4, 4), 6.0),
            np.full((4, 4), 0.9),
        )
        for name, camera in rig.cameras.items()
    }
    return rig, points, grids


def _remove_cells(grid: MarkerGrid, *cells: tuple[int, int]) -> MarkerGrid:
    found = grid.detected.copy()
    for cell in cells:
        found[cell] = False
    return replace(grid, detected=found)


@pytest.mark.parametrize("turn", [1, 2, 3])
def test_grids_of_turned_cameras_get_the_numbering_of_the_others(turn):
    rig, points, grids = _make_scene()
    turned = grids["cam2"]
    grids["cam2"] = next(
        g for g in turned.list_numberings() if np.allclose(g.center_px, np.rot90(turned.center_px, turn))
    )
    agreed = align_grids(grids, rig)
    assert list(agreed) == list(rig.cameras)
    found, _ = triangulate_markers(agreed, rig, load())
    np.testing.assert_allclose(found.reshape(4, 4, 3), points, atol=1e-6)


def test_grid_that_contradicts_the_others_is_left_out():
    rig, _, grids = _make_scene()
    away = np.random.default_rng(2).uniform(-25, 25, (4, 4, 2))
    grids["cam3"] = replace(grids["cam3"], center_px=grids["cam3"].center_px + away)
    assert "cam3" not in align_grids(grids, rig)


def test_bounds_contain_the_markers_of_a_region_and_its_neighbours():
    rig, points, grids = _make_scene()
    prior = bound_region_depths(grids, rig, relief_mm=20.0)
    np.testing.assert_allclose(prior.marker_mm, points[..., 2].reshape(-1), atol=1e-6)
    depth = points[..., 2]
    assert prior.near_mm[5] == pytest.approx(depth[:3, :3].min() - 20)
    assert prior.far_mm[0] == pytest.approx(depth[:2, :2].max() + 20)
    near, far = prior.rasterise()
    height, width = rig.core_camera.size_px[::-1]
    assert near.shape == far.shape == prior.labels.shape == (height, width)
    assert np.isnan(near[prior.labels < 0]).all() and (near < far)[prior.labels >= 0].all()
    assert prior.range_mm() == (prior.near_mm.min(), prior.far_mm.max())


def test_marker_with_one_displaced_detection_is_measured_from_the_others():
    rig, points, grids = _make_scene()
    center = grids["cam1"].center_px.copy()
    center[2, 2] += (9.0, 7.0)
    grids["cam1"] = replace(grids["cam1"], center_px=center)
    found, used = triangulate_markers(grids, rig, load())
    assert not used["cam1"][10] and used["cam0"][10]
    np.testing.assert_allclose(found[10], points[2, 2], atol=1e-6)


def test_region_of_an_unmeasured_marker_has_the_bounds_of_its_neighbours():
    rig, _, grids = _make_scene()
    alone = {name: grid if name == "cam0" else _remove_cells(grid, (0, 0)) for name, grid in grids.items()}
    prior = bound_region_depths(alone, rig)
    assert np.isnan(prior.marker_mm[0]) and np.isfinite([prior.near_mm[0], prior.far_mm[0]]).all()


def test_bounds_without_core_or_with_too_few_markers_are_refused():
    rig, _, grids = _make_scene()
    with pytest.raises(ReconstructionError, match="core camera cam0"):
        bound_region_depths({"cam1": grids["cam1"]}, rig)
    with pytest.raises(ReconstructionError, match="only 0 of 16"):
        bound_region_depths({"cam0": grids["cam0"]}, rig)


def test_warnings_name_cameras_without_speckle():
    rig, _ = make_world_rig()
    dark = np.zeros((320, 400), np.uint8)
    reporter = Silent()
    assert detect_marker_grids(FrameSet("007", {"cam0": dark, "cam1": dark}), rig, reporter) == {}
    assert reporter.warnings == [f"frame 007: no speckle markers in the image of cam{i}" for i in (0, 1)]


@needs_rendered
@pytest.mark.parametrize("scene", ["belt_empty", "belt_loaded", "module"])
def test_rendered_scenes_lie_within_their_bounds(scene):
    rig, frames = read_halved_rig(), read_halved_frames(scene)
    assert detect_marker_grid(frames.images["cam0"]) is not None
    prior = bound_region_depths(detect_marker_grids(frames, rig, Silent()), rig)
    depth, _ = read_halved_truth(scene)
    near, far = prior.rasterise()
    known = np.isfinite(depth) & (prior.labels >= 0)
    assert known.sum() > 0.95 * np.isfinite(depth).sum()
    assert ((depth >= near) & (depth <= far))[known].mean() > 0.995
