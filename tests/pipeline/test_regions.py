"""The picture of the projected markers that ``reconstruct`` draws where there are any."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.frames import FrameSet
from beltscape.files.images import read_image, write_image
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.reconstructing.frame_writer import write_regions
from beltscape.stereo.markers.grid import detect_marker_grid
from tests.synthetic.demo import DEMO, TRUE_RIG, parse_json

RINGED = (80, 255, 120)


def covered(image: np.ndarray) -> np.ndarray:
    """The image with dots from beside every marker copied over it, a few pixels beyond its rim."""
    grid = detect_marker_grid(image)
    assert grid is not None
    rich, (height, width) = image.copy(), image.shape[:2]
    half = int(np.nanmax(grid.radius_px)) + 5
    for u, v in np.rint(grid.center_px.reshape(-1, 2)).astype(int):
        rows = np.arange(max(v - half, 0), min(v + half + 1, height))
        columns = np.arange(max(u - half, 0), min(u + half + 1, width))
        aside = 2 * half + 1 if u + 3 * half + 1 < width else -(2 * half + 1)
        rich[np.ix_(rows, columns)] = image[np.ix_(rows, columns + aside)]
    return rich


def reconstructed(run, capture, out):
    code, text, _ = run(
        "reconstruct", capture, "--rig", TRUE_RIG, "--out", out, "--method", "binocular", "--json"
    )
    assert code == 0
    return parse_json(text)


def test_draws_the_cameras_that_were_used(run, tmp_path):
    document = reconstructed(run, DEMO / "module", tmp_path / "r")
    assert document["regions"] == str(tmp_path / "r" / "regions.png")
    picture = read_image(tmp_path / "r" / "regions.png")
    assert picture.shape[1] <= 1600 and picture.shape[2] == 3
    halves = np.array_split(picture.astype(int), 2, axis=1)  # the core and one auxiliary
    assert all((np.abs(half - RINGED).max(axis=2) < 30).sum() > 200 for half in halves)


def test_pattern_without_markers_causes_no_warning(run, capture, tmp_path):
    folder = capture("module")
    for path in sorted(folder.glob("*/*.png")):
        write_image(path, covered(read_image(path)))
    document = reconstructed(run, folder, tmp_path / "r")
    assert document["regions"] is None and document["warnings"] == []
    assert document["frames"][0]["coverage"] > 0.5
    written = sorted(path.name for path in (tmp_path / "r").iterdir())
    assert written == [".beltscape.json", "000", "reconstruction.json", "rig.json"]


@pytest.mark.thorough
def test_draws_the_first_frame_that_is_measured(run, capture, tmp_path):
    folder = capture("module")
    for path in sorted(folder.glob("cam[03]/000.png")):
        image = read_image(path)
        write_image(path.with_name("001.png"), image)
        write_image(path, image if path.parent.name == "cam0" else np.zeros((9, 9), np.uint8))
        write_image(path.with_name("002.png"), covered(image))
    for camera in ("cam1", "cam2", "cam4"):
        (folder / camera / "000.png").unlink()
        (folder / camera).rmdir()
    document = reconstructed(run, folder, tmp_path / "r")
    assert [frame["frame"] for frame in document["frames"]] == ["001", "002"]
    assert document["regions"] == str(tmp_path / "r" / "regions.png")


@pytest.mark.parametrize("missing", ["core", "auxiliary", "agreement"])
def test_markers_in_one_camera_only_are_ignored(missing, tmp_path):
    rig = read_rig(TRUE_RIG)
    core, aux = (read_image(DEMO / "belt_empty" / name / "000.png") for name in ("cam0", "cam1"))
    path = tmp_path / "regions.png"
    assert write_regions(path, FrameSet("000", {"cam0": core, "cam1": aux}), rig, ("cam0", "cam1")) == path
    path.unlink()
    seen = {
        "core": {"cam0": np.zeros_like(core), "cam1": aux},
        "auxiliary": {"cam0": core},
        # rays to the same pixels of two cameras do not meet
        "agreement": {"cam0": core, "cam1": core},
    }[missing]
    assert write_regions(path, FrameSet("000", seen), rig, ("cam0", "cam1")) is None
    assert not path.exists()
