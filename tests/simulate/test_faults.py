"""Simulated faults: each changes only what it describes."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.pose import Pose
from beltscape.simulate.faults.belt import CarryBack, Splice, TornEdge
from beltscape.simulate.faults.cameras import MovedCamera, displace_image
from beltscape.simulate.faults.delivery import EncoderFault, MissingFrames, RepeatedImages
from beltscape.simulate.faults.lighting import OverExposure, ProjectorFault
from beltscape.simulate.faults.obstruction import Dirt
from beltscape.simulate.faults.settings import Faults, apply_to_images
from beltscape.simulate.rendering.sensor import Sensor, expose
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.scene_assembly import SimulatedScene
from beltscape.simulate.shapes import Mesh
from beltscape.simulate.solids.belt import BeltSettings
from beltscape.simulate.truth_files import compute_true_area_mm2
from beltscape.simulate.world import World
from tests.simulate.tiny import tiny
from tests.synthetic.light import DOWN, camera, plane, projector, station

ASIDE = Pose.of([0.1, 0.2, 0], [100, 0, 20]) @ DOWN


@pytest.fixture
def pair():
    return station(camera(), camera(name="cam1"), poses=(DOWN, ASIDE))


@pytest.mark.parametrize("name", ["cam0", "cam1"])
def test_only_the_moved_camera_moves(pair, name):
    knocked = MovedCamera(camera=name, rotation_deg=(0, 0.3, 0), shift_mm=(1.0, 0, -2.0)).apply(pair)
    for camera_name in pair.rig.cameras:
        before, after = pair.cam_from_world(camera_name), knocked.cam_from_world(camera_name)
        step = before.apply(after.center_mm)
        turn = (after @ before.inverse()).angle_deg
        np.testing.assert_allclose(step, (1, 0, -2) if camera_name == name else (0, 0, 0), atol=1e-9)
        assert turn == pytest.approx(0.3 if camera_name == name else 0.0, abs=1e-6)
    np.testing.assert_allclose(knocked.rig.cam_from_core["cam0"].rotation, np.eye(3))


def test_dead_projector_changes_nothing_else():
    world = World((plane(),), projector(np.ones((4, 4))), ambient=0.3)
    dark = ProjectorFault(power=0).apply(world)
    assert dark.projector is None
    assert (dark.solids, dark.ambient) == (world.solids, 0.3)


def test_dirt_darkens_only_its_own_pixels():
    light = Dirt(camera="cam0", specks_px=((30.0, 20.0, 5.0),), opacity=0.6).apply(
        np.ones((50, 80, 3), np.float32)
    )
    assert light.dtype == np.float32
    np.testing.assert_allclose(light[20, 30], 0.4, rtol=1e-5)
    np.testing.assert_allclose(light[20, 45:], 1.0)


def test_over_exposure_saturates():
    sensor = Sensor()
    light = np.full((20, 20, 3), 0.5, np.float32)
    assert expose(light, sensor, 0).max() < 150
    assert expose(light, OverExposure(camera="cam0", factor=4.0).apply(sensor), 0).min() > 250


def test_frames_are_missing_in_one_camera_only():
    fault = MissingFrames(camera="cam2", every=3, first=1)
    assert [fault.delivers("cam2", frame) for frame in range(6)] == [True, False, True, True, False, True]
    assert all(fault.delivers("cam1", frame) for frame in range(6))


LIGHT = np.random.default_rng(3).uniform(0.1, 0.9, (96, 128, 3)).astype(np.float32)
ONE_OF_EACH = Faults.model_validate(
    {
        "projector": [{"first": 5, "power": 0.3}],
        "sunlight": [{"first": 5}],
        "flicker": [{"first": 5}],
        "dirt": [{"first": 5, "camera": "cam1", "coverage": 0.3}],
        "lens_cap": [{"first": 5, "camera": "cam1"}],
        "condensation": [{"first": 5, "camera": "cam1"}],
        "dust": [{"first": 5}],
        "defocus": [{"first": 5, "camera": "cam1"}],
        "over_exposure": [{"first": 5, "camera": "cam1"}],
        "moved_camera": [{"first": 5, "camera": "cam1", "rotation_deg": [0.0, 0.5, 0.0]}],
        "vibration": [{"first": 5, "camera": "cam1"}],
        "mirrored_images": [{"first": 5, "camera": "cam1"}],
        "exchanged_cameras": [{"first": 5, "cameras": ["cam0", "cam1"]}],
    }
)


@pytest.mark.parametrize("name", sorted(ONE_OF_EACH.model_fields_set))
def test_image_fault_begins_in_its_frame_and_is_reproducible(name):
    faults = Faults.model_validate({name: getattr(ONE_OF_EACH, name)})
    image = np.rint(255 * LIGHT).astype(np.uint8)
    frames = FrameSet("x", {"cam0": image, "cam1": image[::-1].copy()}, time_ns=625_000_000)
    cameras = {n: camera(128, 96, 120.0, name=n) for n in ("cam0", "cam1")}
    before = apply_to_images(frames, faults, 4, cameras, 700.0)
    after, again = (apply_to_images(frames, faults, 5, cameras, 700.0) for _ in range(2))
    for each in frames.images:
        np.testing.assert_array_equal(before.images[each], frames.images[each])
        np.testing.assert_array_equal(after.images[each], again.images[each])
        assert after.images[each].dtype == np.uint8
    assert not np.array_equal(after.images["cam1"], frames.images["cam1"])


@pytest.mark.parametrize("shape", ["soft", "sharp", "smeared"])
@pytest.mark.parametrize("coverage", [0.05, 0.5, 1.0])
def test_random_dirt_covers_its_share(shape, coverage):
    behind = Dirt(camera="a", coverage=coverage, shape=shape, opacity=1.0).apply(
        np.ones((200, 300), np.float32)
    )
    assert float(1 - behind.mean()) == pytest.approx(coverage, abs=0.06)


def test_dirt_grows_from_frame_to_frame_over_what_it_covered():
    dirt = Dirt(camera="a", coverage=0.4, shape="sharp", first=2, grows_over=4)
    behind = [dirt.apply(np.ones((100, 150), np.float32), frame) for frame in range(8)]
    dirty = [one < 0.99 for one in behind]
    assert [round(float(one.mean()), 1) for one in dirty] == [0, 0, 0.1, 0.2, 0.3, 0.4, 0.4, 0.4]
    assert all(np.all(later[earlier]) for earlier, later in itertools.pairwise(dirty))


def test_rotated_image_is_that_of_the_rotated_camera():
    lens = camera(128, 96, 120.0)
    turn = MovedCamera(camera="a", rotation_deg=(0.0, 1.0, 0.0)).displacement
    smooth = cv2.GaussianBlur(LIGHT[..., 0], (0, 0), 4.0)
    image = (65535 * (smooth - smooth.min()) / np.ptp(smooth)).astype(np.uint16)
    moved = displace_image(image, lens, turn, 700.0)
    point = np.array([10.0, 5.0, 700.0])
    (old_x, old_y), (new_x, new_y) = lens.project(point), lens.project(turn.apply(point))
    places = ((image, (old_y, old_x)), (moved, (new_y, new_x)))
    at = [
        float(map_coordinates(one.astype(float), np.array([[y], [x]]), order=1)[0]) for one, (y, x) in places
    ]
    assert abs(new_x - old_x) > 1
    assert at[0] == pytest.approx(at[1], rel=0.01)


def test_dim_projector_leaves_the_ambient_light():
    ambient = np.full((96, 128), 0.2, np.float32)
    dots = np.zeros_like(ambient)
    dots[::6, ::6] = 0.5
    fault = ProjectorFault(power=0.3)
    np.testing.assert_allclose(fault.apply_to_image(ambient + dots), ambient + 0.3 * dots, atol=1e-5)
    np.testing.assert_allclose(ProjectorFault(power=0).apply_to_image(ambient + dots), ambient, atol=1e-5)


TRUE_MM = np.arange(0.0, 1000.0, 100.0)


@pytest.mark.parametrize(
    ("kind", "size", "readings"),
    [
        ("reversed", None, [0, 100, 200, 300, 200, 100, 200, 300, 400, 500]),
        ("frozen", None, [0, 100, 200, 300, 300, 300, 600, 700, 800, 900]),
        ("lifted", None, [0, 100, 200, 300, 300, 300, 400, 500, 600, 700]),
        ("jumping", 50.0, [0, 100, 200, 300, 450, 550, 650, 750, 850, 950]),
        ("slip", 0.1, [0, 100, 200, 300, 390, 480, 580, 680, 780, 880]),
        ("scale", 1.1, [0, 100, 200, 300, 410, 520, 620, 720, 820, 920]),
        ("reset", None, [0, 100, 200, 300, 100, 200, 300, 400, 500, 600]),
    ],
)
def test_faulty_encoder_counts(kind, size, readings):
    np.testing.assert_allclose(EncoderFault(kind=kind, size=size, first=4, last=5).apply(TRUE_MM), readings)


def test_wild_and_silent_encoder():
    wild = EncoderFault(kind="wild", size=30.0, first=4).apply(TRUE_MM)
    assert 5 < np.std((wild - TRUE_MM)[4:]) < 80
    np.testing.assert_array_equal(wild[:4], TRUE_MM[:4])
    np.testing.assert_array_equal(wild, EncoderFault(kind="wild", size=30.0, first=4).apply(TRUE_MM))
    silent = EncoderFault(kind="silent", first=4, last=6).apply(TRUE_MM)
    assert np.flatnonzero(np.isnan(silent)).tolist() == [4, 5, 6]


def test_carry_back_and_splice_lie_on_the_belt():
    belt = BeltSettings()
    for fault, height in ((CarryBack(thickness_mm=4.0, coverage=0.5), 4.0), (Splice(height_mm=3.0), 3.0)):
        solid = fault.make_solid(belt)
        assert solid is not None
        over = solid.vertices_mm[:, 2] - belt.height_at(*solid.vertices_mm[:, :2].T)
        assert over.max() == pytest.approx(height)
    assert CarryBack(first=3).make_solid(belt, 2) is None


def test_an_object_over_the_belt_swings_and_is_no_load():
    fault = {"size_mm": [100.0, 200.0, 5.0], "sway_mm": [80.0, 0.0], "period": 4, "first": 1, "last": 2}
    scene = SimulatedScene(tiny("belt_moving", frames=4, faults={"foreign_object": [fault]}))
    found = [
        [solid for solid in scene.world_at(frame).solids if solid.name == "foreign_object"]
        for frame in range(4)
    ]
    assert [len(solids) for solids in found] == [0, 1, 1, 0]
    middle = [solids[0].vertices_mm.mean(axis=0) for solids in found[1:3]]
    np.testing.assert_allclose(middle, [[0.0, 0.0, 162.5], [80.0, 0.0, 162.5]], atol=1e-9)
    world = scene.world_at(1)
    sound = World(tuple(one for one in world.solids if one.name != "foreign_object"), world.projector)
    y = np.array([0.0, 40.0])
    areas = [compute_true_area_mm2(one, y, (-60.0, 60.0), 4.0) for one in (world, sound)]
    np.testing.assert_array_equal(areas[0], areas[1])


def test_images_repeat_in_turn_and_come_back():
    fault = RepeatedImages(first=4, every=2, last=7)
    assert [fault.source_frame(frame) for frame in range(3, 10)] == [3, 4, 4, 6, 6, 8, 9]


def test_torn_edge_is_missing_at_its_place_and_passes_with_the_belt():
    torn = {"side": "right", "depth_mm": 60.0, "length_mm": 300.0, "first": 1}
    motion = {"speed_mm_s": 800.0, "frames_per_s": 4.0}
    scene = SimulatedScene(tiny("belt_moving", frames=4, motion=motion, faults={"torn_edge": [torn]}))
    settings, fault = scene.scenario.belt, TornEdge.model_validate(torn)
    whole = settings.half_width_mm[1]
    for frame in range(4):
        belt = next(solid for solid in scene.world_at(frame).solids if solid.name == "belt")
        assert Mesh(belt.vertices_mm, belt.faces).is_closed
        upper = belt.vertices_mm.reshape(-1, 2 * len(settings.section_mm), 3)[:, : len(settings.section_mm)]
        np.testing.assert_allclose(upper[:, 0, 0], -settings.half_width_mm[0])
        place = (upper[:, -1, 1] - scene.belt_position_mm(frame) + 800) % 1600 - 800
        missing = fault.missing_at(place, frame) * np.cos(np.deg2rad(settings.wing_deg))
        np.testing.assert_allclose(whole - upper[:, -1, 0], missing, atol=1e-9)
        assert fault.missing_at(place, frame).max() == pytest.approx(60.0 if frame else 0.0)
        heights = settings.height_at(upper[:, -1, 0], upper[:, -1, 1])
        np.testing.assert_allclose(upper[:, -1, 2], heights, atol=1e-9)


@pytest.mark.parametrize("size", [{"depth_mm": 300.0}, {"length_mm": 1600.0}])
def test_torn_edge_larger_than_the_belt_is_refused(size):
    with pytest.raises(ValueError, match=next(iter(size))):
        Scenario.model_validate({"kind": "belt_empty", "faults": {"torn_edge": [size]}})


def test_risen_belt_moves_with_its_load_and_without_the_floor():
    scene = SimulatedScene(Scenario.model_validate({"kind": "belt_empty", "faults": {
        "moved_belt": [{"first": 2, "rise_mm": 5.0}]}}))  # fmt: skip
    before, after = (scene.world_at(frame).solids for frame in (1, 2))
    lifts = {
        one.name: (two.vertices_mm - one.vertices_mm)[0, 2] for one, two in zip(before, after, strict=True)
    }
    assert lifts == pytest.approx({"belt": 5.0, "floor": 0.0})
