"""``evaluate lumps`` on a simulated folder: with the true depth, with a reconstruction, and refused input."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.rig_json import write_rig
from beltscape.files.tiff import write_float_tiff

SIZE = (300, 240)
SPHERES = [(70, 60, 40.0), (220, 70, 35.0), (90, 170, 30.0), (230, 170, 45.0)]
"""Column, row, radius in mm and px."""


@pytest.fixture
def folders(tmp_path):
    """Four round rocks on a belt 700 mm away, a pixel a millimetre there: truth, and a frame that missed one."""
    v, u = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
    depth = np.full(SIZE[::-1], 700.0)
    rock = np.full(SIZE[::-1], -1, np.int16)
    for number, (column, row, radius) in enumerate(SPHERES):
        inside = radius**2 - (u - column) ** 2 - (v - row) ** 2
        top = 700 - 0.6 * np.sqrt(np.maximum(inside, 0)) - 15 * (inside > 0)
        rock[top < depth] = number
        depth = np.minimum(depth, top)
    cameras = {
        name: Camera(name, SIZE, np.full(2, 700.0), np.array(SIZE) / 2 - 0.5, np.zeros(5))
        for name in ("cam0", "cam1")
    }
    rig = Rig("cam0", cameras, {"cam0": Pose.identity(), "cam1": Pose.of([0, 0, 0], [-200, 0, 0])})
    truth, found = tmp_path / "truth", tmp_path / "found"
    for folder in (truth, found):
        folder.mkdir()
        write_rig(folder / "rig.json", rig)
    size = np.array([2 * radius for *_, radius in SPHERES])
    np.savez(truth / "belt_loaded_depth.npz", depth_mm=depth, rock=rock)
    np.savez(truth / "belt_loaded_rocks.npz", size_mm=size, volume_mm3=0.5 * size**3)
    measured = np.where(rock == 3, 700.0, depth).astype(np.float32)
    write_float_tiff(found / "000" / "depth.tiff", measured)
    write_float_tiff(found / "000" / "sigma.tiff", np.full(depth.shape, 0.05, np.float32))
    return truth, found / "000"


def test_the_true_depth_shows_all_and_a_frame_what_it_measured(folders, capsys):
    truth, frame = folders
    assert main(["evaluate", "lumps", "--truth", str(truth), "--json"]) == 0
    best = json.loads(capsys.readouterr().out)
    assert (best["rocks"], best["recall"], best["precision"]) == (4, 1, 1)
    assert best["rocks_over"] == 3  # 80, 70 and 90 mm; one of 60 is not over 60
    assert best["d50_heap_mm"] > 60
    assert main(["evaluate", "lumps", str(frame), "--truth", str(truth), "--over", "85", "--json"]) == 0
    matched = json.loads(capsys.readouterr().out)
    assert matched["recall"] == 0.75
    assert (matched["rocks_over"], matched["recall_over"]) == (1, 0)


def test_summary_has_a_few_lines(folders, capsys):
    truth, frame = folders
    assert main(["evaluate", "lumps", str(frame), "--truth", str(truth), "--over", "500"]) == 0
    said = capsys.readouterr().out
    assert "4 visible, 75% found" in said
    assert "nan" not in said


def test_what_is_wrong_is_one_line(folders, tmp_path, capsys):
    truth, frame = folders
    assert main(["evaluate", "lumps", "--truth", str(tmp_path)]) == 2
    assert "holds 0 *_rocks.npz" in capsys.readouterr().err
    write_float_tiff(frame / "depth.tiff", np.full((20, 30), 700, np.float32))
    write_float_tiff(frame / "sigma.tiff", np.full((20, 30), 0.1, np.float32))
    assert main(["evaluate", "lumps", str(frame), "--truth", str(truth)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    seen = truth / "belt_loaded_depth.npz"
    seen.write_bytes(seen.read_bytes()[:-50])
    assert main(["evaluate", "lumps", "--truth", str(truth)]) == 2
    assert f"{seen}: is no readable file of arrays" in capsys.readouterr().err
    seen.unlink()
    assert main(["evaluate", "lumps", "--truth", str(truth)]) == 2
    assert "simulate the scene again" in capsys.readouterr().err
