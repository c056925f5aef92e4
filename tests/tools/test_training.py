"""Training in small: the same code draws samples of a tiny capture and fits networks like those that ship."""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
import shutil
import subprocess
import sys
import tomllib
from itertools import islice, pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.learned import registry
from beltscape.learned.registry import PURPOSES, load_network
from beltscape.pipeline.simulation import simulate
from beltscape.workers.options import WorkerOptions
from tests.once import make_once
from tests.simulate.tiny import tiny
from tests.synthetic.boards import row_of_cameras
from tests.thorough import list_cases
from tests.workers.backwards import run_backwards

pytestmark = pytest.mark.slow
TOOLS = Path(__file__).resolve().parents[2] / "tools"
WITHOUT_TORCH = "PyTorch is not installed; pip install 'beltscape[train]' brings it"


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulate a loaded belt of 320 × 264 px; all workers of a run share it, and none writes into it."""

    def make(folder: Path) -> None:
        simulate(tiny("belt_loaded", heap={"rocks": 12}), folder / "capture", Silent())

    return make_once(tmp_path_factory, "training", make) / "capture"


@pytest.fixture(scope="module")
def heap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulate a moving heap and its empty belt, as `training.belts` does; all workers of a run share it."""

    def make(folder: Path) -> None:
        motion = {"start_mm": -120.0, "speed_mm_s": 600.0}
        simulate(tiny("belt_empty", frames=1), folder / "empty", Silent())
        scene = tiny("belt_moving", frames=3, heap={"rocks": 12}, motion=motion)
        simulate(scene, folder / "moving", Silent())

    return make_once(tmp_path_factory, "moving-heap", make)


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch):
    """Return a function that imports a module of the training."""
    monkeypatch.syspath_prepend(str(TOOLS))
    return lambda name: importlib.import_module(f"training.{name}")


def limit_frames(monkeypatch: pytest.MonkeyPatch, module: ModuleType) -> None:
    """Make a module of samples take a capture's unchanged frame only."""
    frames = module.training_frames
    monkeypatch.setattr(module, "training_frames", lambda folder, turn: islice(frames(folder, turn), 1))


def test_scenarios_are_the_same_on_every_draw_and_hold_every_kind(load) -> None:
    scenarios = load("scenarios")
    drawn = [scenarios.draw_scenario(number) for number in range(16)]
    assert drawn == [scenarios.draw_scenario(number) for number in range(16)]
    assert {one.kind for one in drawn} == {"belt_loaded", "module", "belt_empty"}
    assert len({one.rig.seed for one in drawn}) == len(drawn)
    held_out = scenarios.draw_scenario(scenarios.HELD_OUT)
    assert held_out.rig.seed not in {one.rig.seed for one in drawn}


def test_moving_heaps_are_the_same_on_every_draw_and_lie_in_many_ways(load) -> None:
    belts = load("belts")
    moving, again = (
        [belts.draw_heap_in_motion(number, "belt_moving") for number in range(20)] for _ in range(2)
    )
    assert moving == again
    assert len({(one.heap.bedding, one.heap.candidates) for one in moving}) > 5
    assert {one.heap.rocks > 1000 for one in moving} == {True, False}
    empty = belts.draw_heap_in_motion(3, "belt_empty")
    assert (empty.rig, empty.belt) == (moving[3].rig, moving[3].belt)
    assert empty.seed != moving[3].seed
    assert belts.draw_heap_in_motion(belts.HELD_OUT, "belt_moving").heap.seed not in {
        one.heap.seed for one in moving
    }


@pytest.mark.thorough
def test_every_frame_of_two_cameras_has_an_auxiliary(load, monkeypatch) -> None:
    augmentation, rig = load("samples.augmentation"), row_of_cameras(["a", "b"])
    shape = rig.core_camera.size_px[::-1]
    plane = np.full(shape, 700.0)
    images = {name: np.full(shape, 90, np.uint8) for name in rig.cameras}
    two = augmentation.Capture(rig, images, plane, plane.astype(np.uint8), np.ones(shape, int), plane > 0)
    monkeypatch.setattr(augmentation, "read_simulated", lambda _: two)
    for turn in range(augmentation.EVERY):
        for frame in augmentation.training_frames(Path(), turn):
            assert frame.names == ("b",)
            assert set(frame.frame.images) == {"a", "b"}


@pytest.mark.parametrize("name", list_cases(["initial_confidence", "confidence"], ["confidence"]))
def test_samples_of_pixels_have_the_features_of_the_network(load, capture, monkeypatch, name: str) -> None:
    pixels = load("samples.pixels")
    limit_frames(monkeypatch, pixels)
    (sample,) = pixels.draw_pixel_samples(capture, 0, name)
    assert sorted(sample.names) == sorted(load_network(name).features)
    assert sample.features.shape == (len(sample.dz_mm), len(sample.names))


def test_samples_of_candidates_hold_right_and_wrong_ones(load, capture, monkeypatch) -> None:
    pixels = load("samples.pixels")
    limit_frames(monkeypatch, pixels)
    (frame,) = pixels.draw_selection_samples(capture, 0)
    errors = np.concatenate([ds[np.isfinite(found.s)] for _, found, _, ds in frame.draw()])
    assert (np.abs(errors) <= 1.25).any()
    assert (np.abs(errors) > 1.25).any()


def test_tiles_of_the_refinement_survive_their_file(load, capture, tmp_path, monkeypatch) -> None:
    refinement = load("samples.refinement")
    limit_frames(monkeypatch, refinement)
    number = refinement.write_tiles(tmp_path / "0.npz", capture, 1)
    names, tiles = refinement.read_tiles(tmp_path / "0.npz")
    assert len(tiles) == number > 0
    assert names == load_network("refinement").features
    assert {tile.features.shape[1] for tile in tiles} == {len(names)}


def test_samples_of_holes_have_the_features_of_the_network(load, capture) -> None:
    depth = load("reconstructions").reconstruct_capture(capture)
    samples = load("samples.holes").draw_hole_samples(capture, depth)
    assert samples.names == load_network("holes").features
    assert np.isfinite(samples.x).all()
    assert len(samples.x) == len(samples.y) > 0


def test_samples_of_belt_holes_are_the_cells_that_no_frame_measured(load, heap, tmp_path) -> None:
    copy = shutil.copytree(heap, tmp_path / "heap")
    belts = load("samples.belts")
    samples = belts.draw_belt_samples(copy, "fast")
    assert samples.names == load_network("holes").features
    assert np.isfinite(samples.x).all()
    assert len(samples.x) == len(samples.y) == len(samples.scale_mm) > 0
    assert (samples.scale_mm > 0).all()
    base = np.abs(samples.y * samples.scale_mm)
    assert np.median(base) < 20


def test_holes_of_simulated_bodies_are_what_the_camera_does_not_see(load) -> None:
    surfaces = load("samples.surfaces")
    height = np.zeros((40, 60))
    height[:, 20:30] = 12.0
    hidden = surfaces.mask_hidden(height, np.array([0.5, 0.0]))  # a wall of 12 hides 6 cells behind it
    assert hidden[:, 30:35].all()
    assert not hidden[:, :30].any()
    assert not hidden[:, 36:].any()
    assert not surfaces.mask_hidden(height, np.zeros(2)).any()
    measured, truth = surfaces.simulate_bodies_seen(np.random.default_rng(3))
    hole = np.isnan(measured.height_mm)
    assert 0 < hole.mean() < 0.5
    assert np.abs(measured.height_mm - truth)[~hole].max() < 3


def test_a_perceptron_learns_a_curve_and_the_same_bytes_twice(load) -> None:
    pytest.importorskip("torch", reason=WITHOUT_TORCH)
    perceptron, losses = load("perceptron"), load("losses")
    perceptron.set_deterministic()
    x = np.random.default_rng(0).uniform(-2, 2, (4000, 2)).astype(np.float32)
    y = np.abs(x[:, 0]) + 0.5 * x[:, 1]
    loss = losses.make_mean_and_variance(y, np.ones(len(y)), 0.1, (-12.0, 3.0))
    schedule = perceptron.Schedule((16,), 15, 128, 1e-2)
    one, two = (
        perceptron.fit_perceptron(("a", "b"), ("mean", "log variance"), x, loss, schedule) for _ in range(2)
    )
    mean, _ = one.predict_mean_and_sigma({"a": x[:, 0], "b": x[:, 1]})
    assert np.sqrt(np.mean((mean - y) ** 2)) < 0.15
    for first, second in zip(one.layers, two.layers, strict=True):
        assert first.tobytes() == second.tobytes()


def test_averaged_and_joined_networks_have_the_outputs_of_their_members(load) -> None:
    pytest.importorskip("torch", reason=WITHOUT_TORCH)
    perceptron = load("perceptron")
    rng = np.random.default_rng(1)

    def make(hidden: tuple[int, ...], output: str) -> Any:
        sizes = (3, *hidden, 1)
        layers = tuple(rng.normal(size=(b, a + 1)).astype(np.float32) for a, b in pairwise(sizes))
        limits = np.array([[-5.0], [5.0]], np.float32).repeat(3, 1)
        return perceptron.Network(("a", "b", "c"), (output,), limits, layers)

    features = dict(zip("abc", rng.normal(size=(3, 20)), strict=True))
    members = [make((4, 5), "y") for _ in range(3)]
    mean = np.mean([member.evaluate_values(features) for member in members], axis=0)
    np.testing.assert_allclose(
        perceptron.average_networks(members).evaluate_values(features), mean, rtol=1e-4, atol=1e-4
    )
    pair = make((4,), "y"), make((6,), "z")
    joined = perceptron.join_outputs(*pair)
    assert joined.outputs == ("y", "z")
    separate = np.concatenate([one.evaluate_values(features) for one in pair])
    np.testing.assert_allclose(joined.evaluate_values(features), separate, rtol=1e-4, atol=1e-4)


def test_every_recipe_gives_a_network_like_the_shipped_one(
    load, capture, heap, tmp_path, monkeypatch
) -> None:
    pytest.importorskip("torch", reason=WITHOUT_TORCH)
    main = load("__main__")
    load("perceptron").set_deterministic()
    for name in ("samples.pixels", "samples.refinement"):
        limit_frames(monkeypatch, load(name))
    monkeypatch.setattr(load("samples.refinement"), "ENOUGH", 2000)
    monkeypatch.setattr(load("refinement"), "EPOCHS", 1)
    monkeypatch.setattr(load("holes"), "SURFACES", 1)
    monkeypatch.setattr(load("lumps"), "CELLS", {60_000: 3000})
    schedules = load("confidence").SCHEDULES
    for name, schedule in schedules.items():
        monkeypatch.setitem(schedules, name, dataclasses.replace(schedule, epochs=3, batch=256))
    holes = load("holes")
    monkeypatch.setattr(holes, "SCHEDULE", dataclasses.replace(holes.SCHEDULE, epochs=3, batch=256))
    copy = shutil.copytree(heap, tmp_path / "heap")
    monkeypatch.setattr("beltscape.workers.tasks.run_in_pool", run_backwards)
    training = main.Training(tmp_path, [capture], [copy], Silent(), WorkerOptions(2))
    trained = {name: network for _, train in main.list_recipes(training) for name, network in train().items()}
    assert trained.keys() == PURPOSES.keys()
    for name, network in trained.items():
        shipped = load_network(name)
        assert sorted(network.features) == sorted(shipped.features)
        assert network.outputs == shipped.outputs
        assert all(np.isfinite(layer).all() for layer in network.layers)


def draw_noise(capture: Path, turn: int) -> dict[str, np.ndarray]:
    """Return a network's weights and noise of the capture's own."""
    noise = np.random.default_rng([turn, len(capture.name)]).normal(size=100)
    weights = load_network("holes").layers[0].ravel()[:100]
    return {"names": np.array(["depth"]), "values": noise + weights, "turn": np.full(100, turn)}


def draw_depth(capture: Path, turn: int) -> dict[str, np.ndarray]:
    """Return the capture's depth as the matcher gives it with the networks in use."""
    found = importlib.import_module("training.reconstructions").reconstruct_capture(capture)
    assert found is not None
    return {
        "names": np.array(["depth"]),
        "depth_mm": found.depth_mm,
        "turn": np.full(len(found.depth_mm), turn),
    }


@pytest.mark.parametrize("draw", [draw_noise, pytest.param(draw_depth, marks=pytest.mark.thorough)])
def test_samples_are_the_same_bytes_with_any_number_of_workers(
    load, capture, tmp_path, monkeypatch, draw
) -> None:
    monkeypatch.setattr("beltscape.workers.tasks.run_in_pool", run_backwards)
    others = [tmp_path / f"capture{number}" for number in range(2)]
    for other in others:
        other.symlink_to(capture)
    Drawing, SampleCache = load("drawing").Drawing, load("cache").SampleCache
    for number, options in ((1, WorkerOptions()), (2, WorkerOptions(2))):
        cache = SampleCache(tmp_path / str(number), Silent(), Drawing(options))
        samples = cache.collect("depth", others, draw)
        assert list(samples["turn"][:: len(samples["turn"]) // 2]) == [0, 1]
    for other in others:
        one, two = (tmp_path / number / "depth" / f"{other.name}.npz" for number in "12")
        assert one.read_bytes() == two.read_bytes()


def test_samples_are_drawn_with_the_networks_in_use(load, capture, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(registry, "_folder", registry._folder)
    cache = load("cache").SampleCache(
        tmp_path / "samples", Silent(), load("drawing").Drawing(networks=tmp_path)
    )
    with pytest.raises(InputError, match=f"{tmp_path}.*is missing"):
        cache.collect("depth", [capture], draw_noise)
    registry.load_network.cache_clear()


def test_the_assessment_scores_the_networks_in_use(load, capture, heap, tmp_path, monkeypatch) -> None:
    pytest.importorskip("torch", reason=WITHOUT_TORCH)
    assessment = load("assessment")
    limit_frames(monkeypatch, load("samples.pixels"))
    copy = shutil.copytree(heap, tmp_path / "heap")
    cache = load("cache").SampleCache(tmp_path / "samples", Silent())
    metrics = assessment.assess_networks([capture], [copy], cache)
    assert metrics.keys() <= PURPOSES.keys()
    assert metrics["confidence"]["area under the ROC curve"] > 0.8
    assert 0.5 < metrics["confidence"]["sigma ratio"] < 2
    score = assessment.assess_reconstruction([capture], "standard")
    assert 0 < score["within 0.25 mm"] < score["within 1 mm"] <= 1
    assert 0 <= score["gross"] < 0.1


def test_a_network_that_is_replaced_has_an_origin_of_its_own(load, tmp_path, monkeypatch) -> None:
    manifest, shipped = load("manifest"), Path(registry.__file__).parents[1] / "data" / "networks"
    monkeypatch.setattr(manifest, "MADE_WITH", ("numpy",))  # PyTorch need not be here
    out = tmp_path / "out"
    shutil.copytree(shipped, out)
    before = json.loads((out / "manifest.json").read_text())
    scores = {"standard": {"gross": 0.5}, "fast": {"gross": 0.25}}
    assessment = manifest.Assessment(7, 3, {"lumps": {"area under the ROC curve": 0.75}}, scores)
    manifest.replace_networks(["lumps"], shipped, out, assessment)
    after = json.loads((out / "manifest.json").read_text())
    lumps = after["networks"].pop("lumps")
    assert lumps["metrics"] == {"area under the ROC curve": 0.75}
    assert lumps["origin"]["scenarios"] == {"training": [0, 6], "held_out": [1000, 1002]}
    assert lumps["sha256"] == before["networks"].pop("lumps")["sha256"]
    assert after["networks"] == before["networks"]
    assert (after["commit"], after["reconstruction"]) == (before["commit"], scores)


def test_the_area_under_the_roc_curve_is_the_share_of_ordered_pairs(load) -> None:
    pytest.importorskip("torch", reason=WITHOUT_TORCH)
    compute_auc = load("assessment").compute_auc
    score, right = np.array([0.1, 0.2, 0.3, 0.4, 0.4]), np.array([False, True, False, True, False])
    assert compute_auc(score, right) == pytest.approx((1 + 2.5) / 6)
    assert np.isnan(compute_auc(score, np.ones(5, bool)))


def test_only_the_program_of_the_training_chooses_instructions(load) -> None:
    pinned = load("instructions").PINNED
    environment = {name: value for name, value in os.environ.items() if name not in pinned}
    code = f"import os, training.scenarios; assert not set({[*pinned]}) & set(os.environ)"
    subprocess.run([sys.executable, "-c", code], cwd=TOOLS, env=environment, check=True)


def test_a_training_takes_the_instructions_that_processors_have_in_common() -> None:
    pytest.importorskip("torch", reason=WITHOUT_TORCH)
    code = (
        "from training.instructions import restart_pinned; restart_pinned(); import torch; "
        "from numpy._core._multiarray_umath import __cpu_features__ as found; "
        "print(torch.backends.cpu.get_cpu_capability(), found.get('X86_V4', False))"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=TOOLS, capture_output=True, text=True, check=True)
    capability, has_avx512 = ran.stdout.split()
    assert capability in ("AVX2", "DEFAULT")  # not AVX512
    assert has_avx512 == "False"


def test_the_makefile_installs_the_torch_of_the_extra() -> None:
    project = tomllib.loads((TOOLS.parent / "pyproject.toml").read_text("utf-8"))
    (torch,) = project["project"]["optional-dependencies"]["train"]
    assert f"'{torch}'" in (TOOLS.parent / "Makefile").read_text("utf-8")
