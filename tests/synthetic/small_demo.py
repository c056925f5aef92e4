"""The demo's capture by fewer cameras with smaller images, for tests of what does not depend on the size."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import tifffile

import beltscape as bs
from beltscape.files.images import read_image
from tests.synthetic.demo import DEMO, choose_demo_rig

CAMERAS = ("cam0", "cam1", "cam2", "cam3")
"""The core camera and three auxiliaries."""
SCALE = 0.5
LEFT_OUT = ("001", "007", "013")
"""Views of the board that the small capture does without."""


def make_small_demo(folder: Path) -> None:
    """Write the demo's folder with some of its cameras and a quarter of their pixels."""
    for path in sorted(DEMO.glob("*/*/*.*")):
        scene, camera, name = path.parts[-3:]
        if camera in CAMERAS and Path(name).stem not in LEFT_OUT:
            write(folder / scene / camera / name, shrink(read_image(path)))
    for path in DEMO.glob("*.toml"):
        shutil.copy(path, folder)
    (folder / "truth").mkdir()
    shutil.copy(DEMO / "truth/volume.json", folder / "truth")
    for path in (DEMO / "truth").glob("*.tiff"):
        tifffile.imwrite(folder / "truth" / path.name, shrink(tifffile.imread(path)))
    bs.write_rig(choose_demo_rig(CAMERAS, SCALE), folder / "truth/rig.json")


def shrink_images(capture: Path, scale: float) -> None:
    """Shrink all images of a capture."""
    for path in capture.glob("cam*/*.png"):
        write(path, shrink(read_image(path), scale))


def write(path: Path, image: np.ndarray) -> None:
    """Write an image, as a JPEG with little loss."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, 98])


def shrink(image: np.ndarray, scale: float = SCALE) -> np.ndarray:
    """Return the means over larger pixels; NaN where one of them is NaN."""
    return cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
