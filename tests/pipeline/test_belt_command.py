"""``beltscape measure belt``, and ``measure volume`` with its belt.json."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.files.belt_json import read_belt
from beltscape.files.meshes.stl import read_stl
from tests.synthetic.demo import parse_json


def test_measured_belt_is_accepted_by_volume(run, small_frames, tmp_path):
    empty, loaded = small_frames / "belt_empty", small_frames / "belt_loaded" / "000"
    code, out, _ = run("measure", "belt", empty, "--out", tmp_path / "belt.json", "--json")
    assert code == 0
    answer = parse_json(out)
    assert answer["frames"] == 1
    belt, _ = read_belt(tmp_path / "belt.json")
    assert list(belt.across_mm) == answer["across_mm"]
    assert "Empty belt" in (tmp_path / "belt.html").read_text()
    box = ("--along", -100, 100, "--json")
    volumes = [
        parse_json(run("measure", "volume", loaded, "--empty", place, *box)[1])["volume_mm3"]
        for place in (tmp_path / "belt.json", empty, empty / "000")
    ]
    assert volumes[1:] == pytest.approx([volumes[0]] * 2, rel=1e-12)


def test_volume_writes_files_for_other_programs(run, small_frames, tmp_path):
    empty, loaded = small_frames / "belt_empty", small_frames / "belt_loaded" / "000"
    code, out, _ = run(
        "measure", "volume", loaded, "--empty", empty, "--along", -100, 100, "--out", tmp_path, "--json"
    )
    assert code == 0
    answer = parse_json(out)
    corners = read_stl(tmp_path / "load.stl")
    body = float((corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6)
    assert body == pytest.approx(answer["volume_mm3"], rel=0.005)
    assert (tmp_path / "areas.csv").read_text().startswith("y_mm,area_mm2,coverage\n")
    assert 0 < answer["fill"]["level"] < 2
    assert answer["highest"]["height_mm"] > 0
    assert len(answer["centre_of_gravity"]["place_mm"]) == 3


def test_missing_frames_are_refused(run, small_frames, tmp_path):
    empty = small_frames / "belt_empty"
    code, _, err = run("measure", "belt", empty, "--frames", "777", "--out", tmp_path / "b.json")
    assert code == 2
    assert err == [
        f"beltscape: {empty / '777'}: no such folder; give a frame folder of beltscape reconstruct"
    ]
    code, _, err = run("measure", "belt", tmp_path, "--out", tmp_path / "b.json")
    assert code == 2
    assert len(err) == 1
    assert err[0].startswith(
        f"beltscape: {tmp_path}: no frame folder with a depth.tiff; give a reconstruction"
    )
