"""Input that the work survives: each defect is a warning with its file and what follows from it."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from beltscape.files.images import write_image
from beltscape.files.rig_json import read_rig, write_rig

pytestmark = pytest.mark.usefixtures("desk")


def test_missing_damaged_and_differing_images_are_warned_about(calibrate, charuco_capture):
    for name in ("cam0", "cam1"):
        shutil.copytree(charuco_capture.folder / name, Path("capture", name), dirs_exist_ok=True)
    Path("capture/cam0/02.png").write_bytes(b"")
    data = Path("capture/cam0/03.png").read_bytes()
    Path("capture/cam0/03.png").write_bytes(data[: len(data) // 2])
    Path("capture/cam1/03.png").unlink()
    write_image(Path("capture/cam1/04.png"), np.full((40, 50), 90, np.uint8))
    assert calibrate() == (
        0,
        [
            "warning: capture/cam1: no image for frame 03; going on without",
            "warning: capture/cam0/02.png: the file is empty (0 bytes); copy the image again; "
            "going on without this image",
            "warning: capture/cam0/03.png: the file is damaged or cut short; copy the image again; "
            "going on without this image",
            "warning: capture/cam1/04.png: 50×40 px, but cam1's other images have 480×400; "
            "going on without this image",
        ],
    )


@pytest.mark.thorough
def test_a_camera_that_shares_no_view_is_warned_about(calibrate, charuco_capture):
    for name, path in zip("abcdefghijkl", sorted((charuco_capture.folder / "cam2").iterdir()), strict=False):
        Path("capture/cam2").mkdir(exist_ok=True)
        shutil.copy(path, f"capture/cam2/later_{name}.png")
    code, lines = calibrate()
    assert (code, lines[-1]) == (
        0, "warning: camera cam2 shares no view of the board with cam0, cam1; going on without it",
    )  # fmt: skip
    assert set(read_rig(Path("out/rig.json")).cameras) == {"cam0", "cam1"}


def test_a_camera_the_capture_lacks_is_warned_about(run, charuco_capture):
    write_rig(Path("rig.json"), charuco_capture.rig)
    assert run("check", "capture", "--rig=rig.json", "--board=board.toml") == (
        0, ["warning: capture/cam2: no images of camera cam2; going on without it"],
    )  # fmt: skip
