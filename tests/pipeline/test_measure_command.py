"""``beltscape measure volume``: output, the box, and refused input."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
import tifffile

from beltscape.files.json_text import read_json
from beltscape.files.rig_json import read_rig, write_rig
from tests.synthetic.demo import parse_json


def test_answer_and_files_follow_the_contract(run, small_frames, tmp_path):
    loaded, empty = small_frames / "belt_loaded" / "000", small_frames / "belt_empty" / "000"
    code, out, _ = run(
        "measure", "volume", loaded, "--empty", empty, "--across", -250, 260, "--along", -150, 150,
        "--out", tmp_path / "v", "--json",
    )  # fmt: skip
    assert code == 0
    answer = parse_json(out)
    assert answer["across_mm"] == [-250, 260]
    assert answer["along_mm"] == [-150, 150]
    assert 0 < answer["coverage"] <= 1
    assert 0 < answer["sigma_mm3"] < answer["volume_mm3"]
    grid = read_json(tmp_path / "v" / "volume.json")["load_grid"]
    load = tifffile.imread(tmp_path / "v" / "load.tiff")
    x = grid["origin_mm"][0] + grid["cell_mm"] * np.arange(load.shape[1])
    y = grid["origin_mm"][1] - grid["cell_mm"] * np.arange(load.shape[0])
    inside = load[(np.abs(y) < 150)[:, None] & ((x > -250) & (x < 260))[None]]
    assert inside.mean() * 510 * 300 == pytest.approx(answer["volume_mm3"], rel=0.02)
    profiles = (tmp_path / "v" / "profiles.csv").read_text().splitlines()
    assert profiles[0] == "y_mm,x_mm,height_mm"
    total = sum(profile["area_mm2"] for profile in answer["profiles"]) * 300 / len(answer["profiles"])
    assert total == pytest.approx(answer["volume_mm3"], rel=0.01)
    assert "<canvas" not in (tmp_path / "v" / "report.html").read_text()


def test_volumes_of_neighbouring_boxes_add_up(run, small_frames, small_belt):
    words = ("measure", "volume", small_frames / "belt_loaded" / "000")
    words += ("--empty", small_belt, "--across", -300, 300, "--json")
    parts = [
        parse_json(run(*words, "--along", a, b)[1])["volume_mm3"] for a, b in ((-120, -7.3), (-7.3, 120))
    ]
    whole = parse_json(run(*words, "--along", -120, 120)[1])["volume_mm3"]
    assert sum(parts) == pytest.approx(whole, rel=2e-3)


def test_volume_of_an_empty_belt_is_zero(run, small_frames):
    empty = small_frames / "belt_empty" / "000"
    answer = parse_json(run("measure", "volume", empty, "--empty", empty, "--json")[1])
    assert abs(answer["volume_mm3"]) < min(3 * answer["sigma_mm3"], 2000)


def test_folder_without_a_frame_is_refused(run, small_frames, tmp_path):
    loaded = small_frames / "belt_loaded" / "000"
    code, out, err = run("measure", "volume", loaded, "--empty", tmp_path / "nothing")
    assert (code, out) == (2, "")
    (line,) = err
    assert line.startswith(f"beltscape: {tmp_path / 'nothing'}: no such file or folder; give a belt.json of")


def test_only_frame_of_a_reconstruction_is_used_and_several_are_listed(
    run, small_frames, small_belt, tmp_path
):
    loaded = small_frames / "belt_loaded"
    words = ("--empty", small_belt, "--along", -100, 100, "--json")
    answers = [parse_json(run("measure", "volume", place, *words)[1]) for place in (loaded, loaded / "000")]
    assert answers[0] == answers[1]
    several = tmp_path / "several"
    for name in ("000", "001", "002", "003", "004", "005"):
        shutil.copytree(loaded / "000", several / name)
    assert run("measure", "volume", several, *words)[2] == [
        f"beltscape: {several}: holds the frames 000, 001, 002, 003 and 2 more; "
        f"give one of them, such as {several}/000"
    ]


def test_frames_of_different_rigs_are_refused(run, small_frames, tmp_path):
    other = tmp_path / "other" / "000"
    shutil.copytree(small_frames / "belt_empty" / "000", other)
    rig = read_rig(small_frames / "belt_empty" / "rig.json")
    camera = rig.core_camera
    object.__setattr__(camera, "focal_px", camera.focal_px * 1.01)
    write_rig(other.parent / "rig.json", rig)
    loaded = small_frames / "belt_loaded" / "000"
    code, _, err = run("measure", "volume", loaded, "--empty", other)
    assert code == 2
    assert err[-1] == (
        f"beltscape: {loaded} and {other}: reconstructed with different rigs; "
        "reconstruct both with the same rig.json"
    )


def test_reversed_box_is_refused(run, small_frames, small_belt):
    loaded, empty = small_frames / "belt_loaded" / "000", small_belt
    code, _, err = run("measure", "volume", loaded, "--empty", empty, "--along", 100, -100)
    assert code == 2
    assert err == ["beltscape: --along 100 -100: the first number must be the smaller one"]


def test_box_outside_is_refused_with_the_measured_range(run, small_frames, small_belt):
    loaded, empty = small_frames / "belt_loaded" / "000", small_belt
    code, _, err = run("measure", "volume", loaded, "--empty", empty, "--along", 5000, 6000)
    assert code == 2
    assert err[-1].startswith(
        "beltscape: --along 5000 6000: nothing was measured there; the belt was seen from "
    )


def test_unknown_quantity_is_refused_in_one_line(run):
    code, _, err = run("measure", "weather", "x")
    assert code == 2
    assert len(err) == 1
    assert err[0].startswith(
        "beltscape measure: argument QUANTITY: invalid choice: 'weather' (choose from 'belt', "
    )


def test_setting_out_of_bounds_is_refused_in_one_line(run, small_frames):
    words = (
        "measure",
        "volume",
        small_frames / "belt_loaded" / "000",
        "--empty",
        small_frames / "belt_empty" / "000",
    )
    for option, value, line in (
        (
            "--cell",
            1000,
            "--cell 1000: cannot be the edge of a cell in mm (0.02 to 100); in micrometres? write 1",
        ),
        ("--cell", -2, "--cell -2: must be greater than 0"),
        ("--profile-every", 0, "--profile-every 0: must be greater than 0"),
    ):
        code, _, err = run(*words, option, value)
        assert code == 2
        assert err == [f"beltscape: {line}"]
