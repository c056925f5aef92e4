"""The capture that ships with the demo, smaller forms of it, and JSON output of the program."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

import beltscape
from beltscape.core.geometry.rig import Rig, scale_rig
from beltscape.files.images import read_image, write_image
from beltscape.files.rig_json import read_rig, write_rig

DEMO = Path(beltscape.__file__).parent / "data" / "demo"
TRUE_RIG = DEMO / "truth" / "rig.json"
SCENES = ("belt_empty", "belt_loaded", "module")
SMALL_CAMERAS = ("cam0", "cam1", "cam3")
"""The core with an auxiliary in either direction."""


def parse_json(text: str) -> dict:
    """Parse the single JSON document on standard output."""
    document = json.loads(text)
    assert isinstance(document, dict)
    return document


def choose_demo_rig(cameras: Sequence[str] = SMALL_CAMERAS, factor: float = 0.5) -> Rig:
    """Return the demo's true rig with these cameras only, scaled."""
    rig = scale_rig(read_rig(TRUE_RIG), factor) if factor != 1.0 else read_rig(TRUE_RIG)
    return replace(
        rig,
        cameras={name: rig.cameras[name] for name in cameras},
        cam_from_core={name: rig.cam_from_core[name] for name in cameras},
    )


def write_demo(
    folder: Path,
    cameras: Sequence[str] = SMALL_CAMERAS,
    scenes: Sequence[str] = SCENES,
    factor: float = 0.5,
) -> None:
    """Write scenes of the demo with fewer cameras and smaller images, the true rig, its depth and board.toml.

    The scene ``calibration`` has eight frames of the board. In half of the size the speckle is hardly resolved: a
    third to a half of the surface is measured, without a warning.
    """
    rig = choose_demo_rig(cameras, factor)
    for camera in cameras:
        for scene in scenes:
            (folder / scene / camera).mkdir(parents=True)
            for path in sorted((DEMO / scene / camera).iterdir())[:8]:
                if factor == 1.0:
                    shutil.copy(path, folder / scene / camera)
                    continue
                size_px = rig.cameras[camera].size_px
                image = cv2.resize(read_image(path), size_px, interpolation=cv2.INTER_AREA)
                write_image(folder / scene / camera / path.name, np.asarray(image, np.uint8))
    (folder / "truth").mkdir()
    write_rig(folder / "truth" / "rig.json", rig)
    shutil.copy(DEMO / "board.toml", folder)
    if factor == 1.0:
        for path in (DEMO / "truth").glob("[!r]*"):
            shutil.copy(path, folder / "truth")
