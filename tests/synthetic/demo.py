"""The capture that ships with the demo, smaller forms of it, and JSON output of the program."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import beltscape
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig, scale_rig
from beltscape.files.images import read_image, write_image
from beltscape.files.rig_json import read_rig, write_rig
from beltscape.files.tiff import read_float_tiff, write_float_tiff

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


CROPPED_PX = (468, 320)
"""Images of less than 460 px of width are slower: their surface is looked for in the full size."""
MIDDLE = (slice(96, 416), slice(72, 540))
"""Rows and columns of the cropped image in the demo's, whose speckle it keeps resolved."""
ALL_CAMERAS = ("cam0", "cam1", "cam2", "cam3", "cam4")


def crop_demo_rig(cameras: Sequence[str] = ALL_CAMERAS) -> Rig:
    """Return the demo's true rig for the middle of its images, with these cameras only."""
    rig = choose_demo_rig(cameras, 1.0)
    first = np.array([MIDDLE[1].start, MIDDLE[0].start])
    smaller = {
        name: replace(camera, size_px=CROPPED_PX, center_px=camera.center_px - first)
        for name, camera in rig.cameras.items()
    }
    return replace(rig, cameras=smaller)


def read_cropped_frame(scene: str, cameras: Sequence[str] = ALL_CAMERAS) -> FrameSet:
    """Return the middle of the images of a scene."""
    images = {name: read_image(DEMO / scene / name / "000.png")[MIDDLE] for name in cameras}
    return FrameSet("000", {name: np.ascontiguousarray(image) for name, image in images.items()})


def read_cropped_truth(scene: str) -> NDArray[np.float32]:
    """Return the true depth in the middle of a scene."""
    return np.ascontiguousarray(read_float_tiff(DEMO / "truth" / f"{scene}_depth.tiff")[MIDDLE])


def crop_demo(folder: Path, scenes: Sequence[str] = SCENES, cameras: Sequence[str] = ALL_CAMERAS) -> None:
    """Write the middle of the images of scenes, and truth/rig.json for it."""
    for scene in scenes:
        for name, image in read_cropped_frame(scene, cameras).images.items():
            write_image(folder / scene / name / "000.png", image)
    (folder / "truth").mkdir()
    write_rig(folder / "truth" / "rig.json", crop_demo_rig(cameras))


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
                size_px = rig.cameras[camera].size_px
                image = cv2.resize(read_image(path), size_px, interpolation=cv2.INTER_AREA)
                write_image(folder / scene / camera / path.name, np.asarray(image, np.uint8))
    (folder / "truth").mkdir()
    write_rig(folder / "truth" / "rig.json", rig)
    shutil.copy(DEMO / "board.toml", folder)
    shutil.copy(DEMO / "truth" / "volume.json", folder / "truth")
    for scene in set(scenes) & set(SCENES):
        depth = read_float_tiff(DEMO / "truth" / f"{scene}_depth.tiff")
        rays = rig.core_camera.rays()
        full = choose_demo_rig(cameras, 1.0).core_camera
        u, v = np.rint(rays * full.focal_px + full.center_px).astype(int).transpose(2, 0, 1)
        near = depth[v.clip(0, depth.shape[0] - 1), u.clip(0, depth.shape[1] - 1)]
        write_float_tiff(folder / "truth" / f"{scene}_depth.tiff", near)
