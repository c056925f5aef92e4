"""Fixture: a plant whose cameras see a belt that stands, in images of 408 × 341 px."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from beltscape.core.geometry.rig import scale_rig
from beltscape.core.progress import Silent
from beltscape.files.images import read_image
from beltscape.files.rig_json import read_rig, write_rig
from beltscape.pipeline.reconstructing.reconstruction import reconstruct_capture
from tests.once import make_once
from tests.synthetic.demo import DEMO, TRUE_RIG

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
SCALE = 2 / 3
"""Of the demo's images: in half of their width two cameras share too few points to check the rig."""
FRAMES = ("000", "001", "002")


@pytest.fixture
def plant(tmp_path: Path, standing_belt: Path) -> Path:
    """project.toml beside a capture of a belt that stands, three frames of it."""
    shutil.copytree(standing_belt, tmp_path, dirs_exist_ok=True)
    (tmp_path / "project.toml").write_text(PROJECT)
    return tmp_path / "project.toml"


@pytest.fixture(scope="session")
def standing_belt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """rig.json, the frame ``empty`` of the empty belt, and the capture ``belt``; nobody writes into it."""
    return make_once(tmp_path_factory, "standing_belt", _make_standing_belt)


def _make_standing_belt(folder: Path) -> None:
    rig = scale_rig(read_rig(TRUE_RIG), SCALE)
    write_rig(folder / "rig.json", rig)
    for camera in rig.cameras:
        for scene, frames in (("belt_empty", FRAMES[:1]), ("belt_loaded", FRAMES)):
            full = read_image(DEMO / scene / camera / "000.png")
            image = cv2.resize(full, rig.cameras[camera].size_px, interpolation=cv2.INTER_AREA)
            (folder / scene / camera).mkdir(parents=True)
            for seed, frame in enumerate(frames):  # noise of their own: equal images are refused
                noise = np.random.default_rng(seed).integers(-1, 2, image.shape)
                noisy = np.clip(image + noise, 0, 255).astype(np.uint8)
                cv2.imwrite(str(folder / scene / camera / f"{frame}.png"), noisy)
    reconstruct_capture(folder / "belt_empty", rig, folder / "matched", Silent(), preset="fast")
    shutil.move(folder / "matched" / "000", folder / "empty")
    shutil.copy(folder / "rig.json", folder / "empty" / "rig.json")
    shutil.rmtree(folder / "matched")
    shutil.rmtree(folder / "belt_empty")
    shutil.move(folder / "belt_loaded", folder / "belt")
    rows = "".join(f"{frame},{0.1 * k},{5000.0}\n" for k, frame in enumerate(FRAMES))
    (folder / "belt" / "encoder.csv").write_text("frame,timestamp_s,belt_position_mm\n" + rows)
