"""The training tools run on a tiny capture, and write what the program reads."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import beltscape
from beltscape.core.progress import Silent
from beltscape.pipeline.simulation import simulate
from tests.simulate.tiny import tiny

pytestmark = pytest.mark.slow
TOOLS = Path(__file__).resolve().parents[2] / "tools"
DATA = Path(beltscape.__file__).parent / "data"


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    """Simulate a loaded belt of 320 × 264 px."""
    folder = tmp_path_factory.mktemp("training") / "capture"
    simulate(tiny("belt_loaded", heap={"rocks": 12}), folder, Silent())
    return folder


@pytest.fixture
def tool(monkeypatch):
    """Return a function that imports a tool; training frames are the unchanged ones only."""
    monkeypatch.syspath_prepend(str(TOOLS))

    def load(name: str) -> ModuleType:
        module = importlib.import_module(name)
        for user in ("pixel_samples", "refinement_samples"):
            if user in sys.modules:
                monkeypatch.setattr(sys.modules[user], "training_frames", first_training_frame)
        return module

    return load


def first_training_frame(folder: Path, turn: int) -> Iterator[Any]:
    """Yield only a capture's unchanged frame."""
    return islice(importlib.import_module("augmentation").training_frames(folder, turn), 1)


def shapes(document: Any) -> list[tuple[int, ...]]:
    """Return the shapes of a network's layers."""
    return [np.shape(layer["weights"] if isinstance(layer, dict) else layer) for layer in document["layers"]]


def read(path: Path) -> Any:
    return json.loads(path.read_text("utf-8"))


def test_adam_fits_a_line(tool):
    adam = tool("adam")
    x = np.linspace(-1, 1, 500, dtype=np.float32)[:, None]
    layers = adam.fit_layers(
        x,
        1,
        lambda out, at: 2 * (out - 3 * x[at]) / len(at),
        adam.Schedule((8,), 1500, 2000, rate=0.03),
        np.random.default_rng(0),
    )
    (first, offset), (last, end) = layers
    np.testing.assert_allclose(np.maximum(x @ first + offset, 0) @ last + end, 3 * x, atol=0.1)


@pytest.mark.parametrize("network", ["initial_confidence", "candidates", "pairwise_ranking", "confidence"])
def test_train_confidence_writes_a_network_like_the_shipped_one(
    tool, capture, tmp_path, monkeypatch, network
):
    train_confidence = tool("train_confidence")
    for name, plan in train_confidence.PLANS.items():
        monkeypatch.setitem(train_confidence.PLANS, name, plan._replace(epochs=1))
    monkeypatch.setattr(sys, "argv", ["", network, str(capture), "--out", str(tmp_path)])
    train_confidence.main()
    written, shipped = read(tmp_path / f"{network}.json"), read(DATA / f"{network}.json")
    assert sorted(written["names"]) == sorted(shipped["names"])  # features are found by name
    assert shapes(written) == shapes(shipped)
    assert np.isfinite(np.concatenate([np.ravel(layer) for layer in written["layers"]])).all()


def test_train_lumps_writes_a_network_like_the_shipped_one(tool, capture, tmp_path, monkeypatch):
    train_lumps = tool("train_lumps")
    monkeypatch.setattr(train_lumps, "EPOCHS", 1)
    monkeypatch.setattr(train_lumps, "CELLS", {60_000: 3000})
    train_lumps.main(str(tmp_path / "lumps.json"), str(capture))
    assert shapes(read(tmp_path / "lumps.json")) == shapes(read(DATA / "lumps.json"))


@pytest.mark.parametrize("network", ["holes", "edge_fattening"])
def test_train_holes_fits_a_network_like_the_shipped_one(tool, monkeypatch, network):
    train_holes = tool("train_holes")
    monkeypatch.setattr(train_holes, "SMOOTH_SURFACES", 1)
    monkeypatch.setattr(train_holes, "CELLS", {"holes": 500, "edge_fattening": 500})
    train_holes.draw_smooth_samples.cache_clear()
    document = train_holes.fit_network([], network).to_document()
    train_holes.draw_smooth_samples.cache_clear()
    assert shapes(document) == shapes(read(DATA / f"{network}.json"))


def test_refinement_tiles_are_written_and_read(tool, capture, tmp_path):
    refinement_samples = tool("refinement_samples")
    number = refinement_samples.write_tiles(tmp_path / "000.npz", capture, 1)
    names, tiles = refinement_samples.read_tiles(tmp_path / "000.npz")
    assert len(tiles) == number > 0
    assert list(names) == read(DATA / "refinement.json")["names"]
    assert all(
        tile.features.shape[1] == np.shape(read(DATA / "refinement.json")["limits"])[1] for tile in tiles
    )


def test_train_refinement_writes_networks_like_the_shipped_ones(tool, capture, tmp_path, monkeypatch):
    torch = pytest.importorskip("torch", reason="PyTorch is needed by this tool only")
    torch.set_num_threads(1)  # the tests run beside each other
    train_refinement = tool("train_refinement")
    samples = tool("refinement_samples")
    monkeypatch.setattr(samples, "ENOUGH", 2000)
    samples.write_tiles(tmp_path / "000.npz", capture, 1)
    monkeypatch.setattr(train_refinement, "EPOCHS", 1)
    monkeypatch.setattr(sys, "argv", ["", str(tmp_path), str(tmp_path)])
    train_refinement.main()
    assert shapes(read(tmp_path / "refinement.json")) == shapes(read(DATA / "refinement.json"))
    rounds, shipped = (read(folder / "message_passing.json")["rounds"] for folder in (tmp_path, DATA))
    assert [shapes(one) for one in rounds] == [shapes(one) for one in shipped]
