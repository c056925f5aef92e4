"""Captures that do not fit the rig: cameras are named or excluded, or the result is refused or marked."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.progress import Silent
from beltscape.files.reconstruction import read_frame, write_frame
from beltscape.files.rig_json import read_rig, write_rig
from beltscape.pipeline.reconstructing.checked_matcher import CheckedMatcher
from beltscape.stereo.consistency.pose_change import apply_pose_change
from beltscape.stereo.pointcloud import cloud_from_depth
from tests.synthetic.demo import (
    SMALL_CAMERAS,
    crop_demo_rig,
    parse_json,
    read_cropped_frame,
    read_cropped_truth,
)

TRUTH = read_cropped_truth("belt_loaded")


def write_knocked_rig(rig_path, tmp_path, *knocks):
    rig = read_rig(rig_path)
    for camera, degrees in knocks:
        rig = apply_pose_change(rig, camera, np.concatenate([np.deg2rad(degrees), np.zeros(3)]))
    write_rig(tmp_path / "off.json", rig)
    return tmp_path / "off.json"


@pytest.fixture
def exchange(cropped, tmp_path):
    """A function that returns a copy of the loaded belt with the folders of two cameras exchanged."""

    def copy(one: str, other: str) -> Path:
        folder = Path(shutil.copytree(cropped / "belt_loaded", tmp_path / "belt_loaded"))
        (folder / one).rename(folder / "x")
        (folder / other).rename(folder / one)
        (folder / "x").rename(folder / other)
        return folder

    return copy


def make_depth(values):
    known = np.isfinite(values)
    sigma = np.where(known, 0.05, np.nan).astype(np.float32)
    return DepthMap(values, sigma, np.where(known, 4, 0).astype(np.uint8), known.astype(np.float32))


def reconstruct(run, scene, rig, out):
    return run("reconstruct", scene, "--rig", rig, "--out", out, "--preset", "fast", "--json")


def write_empty_belt(folder, rig):
    """Write rig.json and a frame with the true depth of the empty belt."""
    depth = make_depth(read_cropped_truth("belt_empty"))
    write_frame(
        folder / "000", depth, cloud_from_depth(depth, rig.core_camera, None), np.zeros((4, 4, 3), np.uint8)
    )
    write_rig(folder / "rig.json", rig)


@pytest.mark.thorough
def test_knocked_auxiliary_is_excluded_and_the_depth_is_right(run, cropped, cropped_rig, tmp_path):
    knocked = write_knocked_rig(cropped_rig, tmp_path, ("cam2", (0.1, 0.2, 0)))
    code, out, err = reconstruct(run, cropped / "belt_loaded", knocked, tmp_path / "r")
    assert code == 0
    assert any(line.startswith("warning: cam2: it is ") and "without cam2" in line for line in err)
    frame = parse_json(out)["frames"][0]
    assert frame["auxiliaries"] == ["cam1", "cam3", "cam4"]
    assert frame["systematic_mm"] == 0
    found = read_frame(tmp_path / "r" / "000")
    error = (found.depth.depth_mm - TRUTH) / found.depth.sigma_mm
    assert np.nanmedian(np.abs(error)) < 1
    document = json.loads((tmp_path / "r" / "reconstruction.json").read_text())
    assert document["format"] == "beltscape-reconstruction/1"
    assert document["frames"][0]["consistency"]["cameras"][1]["state"] == "contradicting"


def test_moved_core_raises_sigma_of_depth_and_volume(run, cropped, cropped_rig, tmp_path):
    full = read_rig(cropped_rig)
    write_rig(tmp_path / "three.json", replace(full, cameras={n: full.cameras[n] for n in SMALL_CAMERAS}))
    rig = write_knocked_rig(tmp_path / "three.json", tmp_path, ("cam0", (0.05, 0, 0)))
    code, _, err = reconstruct(run, cropped / "belt_loaded", rig, tmp_path / "r")
    assert code == 0
    assert any("the core camera cam0 moved" in line for line in err)
    found = read_frame(tmp_path / "r" / "000")
    assert found.depth.systematic_mm > 0.5
    assert np.nanmin(found.depth.sigma_mm) >= found.depth.systematic_mm * 0.999
    error = np.abs(found.depth.depth_mm - TRUTH) / found.depth.sigma_mm
    assert np.nanquantile(error, 0.68) < 1.2
    write_empty_belt(tmp_path / "empty", read_rig(rig))
    code, out, err = run(
        "measure", "volume", tmp_path / "r" / "000", "--empty", tmp_path / "empty" / "000", "--json"
    )
    assert code == 0
    assert any("the core camera cam0 moved" in line for line in err)
    answer = parse_json(out)
    (x0, x1), (y0, y1) = answer["across_mm"], answer["along_mm"]
    assert answer["sigma_mm3"] > 0.9 * found.depth.systematic_mm * (x1 - x0) * (y1 - y0)


@pytest.mark.thorough
def test_frame_whose_cameras_all_moved_is_refused(run, cropped, cropped_rig, tmp_path):
    turns = [
        ("cam1", (0.3, 0.2, 0)),
        ("cam2", (-0.3, 0.3, 0)),
        ("cam3", (0.3, -0.3, 0)),
        ("cam4", (0.2, -0.3, 0.2)),
    ]
    rig = write_knocked_rig(cropped_rig, tmp_path, *turns)
    code, _, err = reconstruct(run, cropped / "belt_loaded", rig, tmp_path / "r")
    assert code == 2
    assert "cam1" in err[-1]
    assert "calibrate again" in err[-1]
    assert "projector" not in err[-1]
    assert not (tmp_path / "r" / "000").exists()


@pytest.mark.thorough
def test_exchanged_folders_are_named(run, exchange, cropped_rig, tmp_path):
    folder = exchange("cam1", "cam3")
    code, out, err = run(
        "reconstruct", folder, "--rig", cropped_rig, "--out", tmp_path / "r", "--preset", "fast"
    )
    assert code == 0
    assert any("the images of cam1 and cam3 are exchanged" in line for line in err)
    assert "cam1  unmatched: " in out
    assert "nan" not in out
    document = json.loads((tmp_path / "r" / "reconstruction.json").read_text())
    assert document["frames"][0]["auxiliaries"] == ["cam2", "cam4"]


@pytest.mark.parametrize("other", ["cam1", pytest.param("cam3", marks=pytest.mark.thorough)])
def test_core_exchanged_with_an_auxiliary_is_named(run, exchange, cropped_rig, tmp_path, other):
    code, _, err = reconstruct(run, exchange("cam0", other), cropped_rig, tmp_path / "r")
    assert code == 2
    assert f"the images of cam0 and {other} are exchanged" in err[-1]


class _TrueDepthMatcher:
    """A matcher that returns the true depth."""

    def reconstruct(self, frame_set, reporter):
        return make_depth(TRUTH)


@pytest.mark.thorough
def test_matcher_continues_with_the_next_consistent_frame():
    rig, frame = crop_demo_rig(), read_cropped_frame("belt_loaded")
    matcher = CheckedMatcher(rig, rig.auxiliaries, (570.0, 750.0), lambda _: _TrueDepthMatcher(), every=50)
    knocked_core = np.roll(frame.images["cam0"], (5, 5), axis=(0, 1))
    other = replace(frame, images={**frame.images, "cam0": knocked_core})
    with pytest.raises(ReconstructionError):
        matcher.reconstruct(other, Silent())
    assert matcher.is_inconsistent
    matcher.reconstruct(frame, Silent())
    assert not matcher.is_inconsistent


def test_narrow_box_causes_a_warning_and_a_larger_sigma(run, small_frames, small_belt, tmp_path):
    shutil.copytree(small_frames / "belt_loaded", tmp_path / "r")
    frame = read_frame(tmp_path / "r" / "000")
    depth = frame.depth.depth_mm.copy()
    depth[:, :125], depth[:, 180:] = np.nan, np.nan
    from beltscape.files.tiff import write_float_tiff

    for name, values in (
        ("depth", depth),
        ("sigma", np.where(np.isfinite(depth), frame.depth.sigma_mm, np.nan)),
    ):
        write_float_tiff(tmp_path / "r" / "000" / f"{name}.tiff", values.astype(np.float32))
    code, out, err = run("measure", "volume", tmp_path / "r" / "000", "--empty", small_belt, "--json")
    assert code == 0
    assert any("mm of the belt's width" in line for line in err)
    answer = parse_json(out)
    assert answer["sigma_from_mm3"]["unseen"] > answer["volume_mm3"]
    assert replace(frame.depth, depth_mm=depth).coverage < 0.3
