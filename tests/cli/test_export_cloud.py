"""``beltscape export`` of a frame's point cloud."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import get_args

import laspy
import numpy as np
import pytest
from laspy.vlrs.known import WktCoordinateSystemVlr

from beltscape.cli.arguments import CLOUD_FORMATS
from beltscape.cli.main import main
from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.belt_json import write_belt
from beltscape.files.clouds import ENDINGS
from beltscape.files.reconstruction import write_frame, write_reconstruction
from beltscape.files.rig_json import write_rig
from beltscape.pipeline.reconstructing.cloud_export import EXTRA_FORMATS
from beltscape.stereo.pointcloud import cloud_from_depth
from beltscape.stereo.settings import Preset
from tests.report.material import belt

CAMERA = Camera("cam0", (40, 30), np.full(2, 50.0), np.array([19.5, 14.5]), np.zeros(5))


def make_depth() -> DepthMap:
    rng = np.random.default_rng(5)
    z = rng.uniform(600, 700, (30, 40)).astype(np.float32)
    z[4:9, 3:20] = np.nan
    confidence = np.where(np.isfinite(z), rng.uniform(0, 1, z.shape), 0).astype(np.float32)
    return DepthMap(z, (z / 5000).astype(np.float32), np.isfinite(z).astype(np.uint8), confidence)


@pytest.fixture(autouse=True)
def frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A reconstruction of one frame in the working folder, depth/000, and belt.json."""
    monkeypatch.chdir(tmp_path)
    folder, depth = Path("depth/000"), make_depth()
    write_rig(Path("depth/rig.json"), Rig("cam0", {"cam0": CAMERA}, {"cam0": Pose.identity()}))
    write_frame(folder, depth, cloud_from_depth(depth, CAMERA, None), np.zeros((2, 2, 3), np.uint8))
    write_reconstruction(Path("depth"), {"method": "multiview", "preset": "fast"}, [{"frame": "000"}])
    write_belt(Path("belt.json"), belt(), CAMERA)
    return folder


def test_a_frame_becomes_laz_with_sigma_confidence_and_provenance(capsys):
    assert main(["export", "depth/000", "--out", "cloud.laz", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    depth, data = make_depth(), laspy.read("cloud.laz")
    assert result["points"] == len(data) == depth.measured.sum()
    assert (result["frame"], result["unit"]) == ("core", "m")
    np.testing.assert_array_equal(data.sigma_mm, depth.sigma_mm[depth.measured])
    np.testing.assert_array_equal(data.confidence, depth.confidence[depth.measured])
    np.testing.assert_allclose(data.xyz * 1000, depth.points_mm(CAMERA)[depth.measured], atol=1e-3)
    (record,) = [one for one in data.header.vlrs if one.user_id == "beltscape"]
    document = json.loads(record.record_data)
    assert (document["method"], document["preset"], document["core"]) == ("multiview", "fast", "cam0")
    assert document["frame_folder"] == "000" and len(document["rig_sha256"]) == 64


def test_the_belts_frame_is_upright(capsys):
    assert main(["export", "depth", "--belt", "belt.json", "--out", "load.las"]) == 0
    assert "belt frame" in capsys.readouterr().out
    depth = make_depth()
    expected = belt().belt_from_core.apply(depth.points_mm(CAMERA)[depth.measured])
    np.testing.assert_allclose(laspy.read("load.las").xyz * 1000, expected, atol=1e-3)
    records = laspy.read("load.las").header.vlrs
    (text,) = [one.string for one in records if isinstance(one, WktCoordinateSystemVlr)]
    assert "z up" in text


def test_ply_keeps_its_bytes(frame):
    assert main(["export", "depth/000", "--out", "copy.ply"]) == 0
    assert Path("copy.ply").read_bytes() == (frame / "cloud.ply").read_bytes()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            ["depth/000", "--out", "cloud.e57"],
            "cloud.e57: no format of point clouds has this ending; use .ply",
        ),
        (["depth/000", "--format", "ros", "--out", "c.laz"], "--format ros: is a rig's"),
        (["depth/rig.json", "--out", "c.laz"], "--format is missing: a rig is written as opencv"),
        (["depth/rig.json", "--format", "ros", "--belt", "belt.json", "--out", "c"], "--belt places a cloud"),
        (["depth/000", "--belt", "depth/rig.json", "--out", "c.laz"], "depth/rig.json: format is"),
        (["gone/000", "--out", "c.laz"], "gone/000: no such file"),
    ],
)
def test_errors_are_one_line(capsys, words, line):
    assert main(["export", *words]) == 2
    (text,) = capsys.readouterr().err.splitlines()
    assert text.startswith(f"beltscape: {line}")
    assert not list(Path().glob("c*"))


def test_the_commands_offer_every_format_of_clouds(capsys):
    assert CLOUD_FORMATS == EXTRA_FORMATS
    with pytest.raises(SystemExit):
        main(["export", "--help"])
    assert ", ".join(ENDINGS) in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("command", [["reconstruct"], ["measure", "flow"]], ids=" ".join)
def test_the_help_names_every_preset(command, capsys):
    with pytest.raises(SystemExit):
        main([*command, "--help"])
    line = re.search(r"--preset PRESET (.*?\))", " ".join(capsys.readouterr().out.split()))
    assert line and [name for name in get_args(Preset) if name not in line[1]] == []
