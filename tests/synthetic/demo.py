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


def crop_demo(
    folder: Path,
    size_px: tuple[int, int],
    scenes: Sequence[str] = SCENES,
    cameras: Sequence[str] = ("cam0", "cam1", "cam2", "cam3", "cam4"),
) -> None:
    """Write the middle of the images of scenes, and truth/rig.json for it: the speckle is resolved.

    Images less than 460 px wide are slower: their surface is looked for in the full size.
    """
    rig = choose_demo_rig(cameras, 1.0)
    cut = find_middle(rig.core_camera.size_px, size_px)
    first = np.array([cut[1].start, cut[0].start])
    for camera in rig.cameras:
        for scene in scenes:
            image = read_image(DEMO / scene / camera / "000.png")
            write_image(folder / scene / camera / "000.png", np.ascontiguousarray(image[cut]))
    smaller = {
        name: replace(camera, size_px=size_px, center_px=camera.center_px - first)
        for name, camera in rig.cameras.items()
    }
    (folder / "truth").mkdir()
    write_rig(folder / "truth" / "rig.json", replace(rig, cameras=smaller))


def find_middle(size_px: tuple[int, int], part_px: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of the middle of an image."""
    x, y = ((whole - part) // 2 for whole, part in zip(size_px, part_px, strict=True))
    return slice(y, y + part_px[1]), slice(x, x + part_px[0])


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
