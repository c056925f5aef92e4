"""Fixture: a plant whose cameras see a belt that stands, in three cameras of 465 × 389 px."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.progress import Silent
from beltscape.files.images import read_image, write_image
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.reconstructing.reconstruction import reconstruct_capture
from tests.once import make_once
from tests.synthetic.demo import SMALL_CAMERAS, write_demo

PROJECT = """rig = "rig.json"
empty = "empty"
[capture]
folder = "belt"
[encoder]
kind = "capture"
[matching]
load_mm = 150
[density]
kg_m3 = 1500
[history]
reserve_mib = 1
[web]
port = 0
"""
FACTOR = 0.76
"""Of the demo's images; from 460 px of width on the surface is looked for in images of half the size."""
FRAMES = ("000", "001")


@pytest.fixture
def plant(tmp_path: Path, standing_belt: Path) -> Path:
    """project.toml beside a capture of a belt that stands, two frames of it."""
    shutil.copytree(standing_belt, tmp_path, dirs_exist_ok=True)
    (tmp_path / "project.toml").write_text(PROJECT)
    return tmp_path / "project.toml"


@pytest.fixture(scope="session")
def standing_belt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """rig.json, the frame ``empty`` of the empty belt, and the capture ``belt``; nobody writes into it."""
    return make_once(tmp_path_factory, "standing_belt", _make_standing_belt)


def _make_standing_belt(folder: Path) -> None:
    write_demo(folder, SMALL_CAMERAS, ("belt_empty", "belt_loaded"), FACTOR)
    rig = read_rig(folder / "truth" / "rig.json")
    for camera in rig.cameras:
        path = folder / "belt_loaded" / camera / "000.png"
        image = read_image(path)
        for seed, frame in enumerate(FRAMES):  # noise of their own: equal images are refused
            noise = np.random.default_rng(seed).integers(-1, 2, image.shape)
            write_image(path.with_name(f"{frame}.png"), np.clip(image + noise, 0, 255).astype(np.uint8))
    shutil.move(folder / "truth" / "rig.json", folder)
    reconstruct_capture(folder / "belt_empty", rig, folder / "matched", Silent(), preset="fast")
    shutil.move(folder / "matched" / "000", folder / "empty")
    shutil.copy(folder / "rig.json", folder / "empty" / "rig.json")
    shutil.rmtree(folder / "matched")
    shutil.rmtree(folder / "belt_empty")
    shutil.move(folder / "belt_loaded", folder / "belt")
    rows = "".join(f"{frame},{0.1 * k},{5000.0}\n" for k, frame in enumerate(FRAMES))
    (folder / "belt" / "encoder.csv").write_text("frame,timestamp_s,belt_position_mm\n" + rows)
