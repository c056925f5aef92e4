"""``beltscape measure belt``, and ``measure volume`` with its belt.json."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.files.belt_json import read_belt
from beltscape.files.stl import read_stl
from beltscape.measure.belt.settings import GivenBelt
from beltscape.pipeline.measuring.belt import (
    measure_empty_belt,
    read_empty_belt,
    require_camera,
    write_belt_files,
)
from beltscape.report.measuring.belt import make_belt_panel
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


def test_volume_writes_files_for_other_programs(run, small_frames, small_belt, tmp_path):
    empty, loaded = small_belt, small_frames / "belt_loaded" / "000"
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


def test_ends_out_of_view_are_named_with_the_fix_and_a_given_width_or_region_settles_them(
    run, small_frames, tmp_path
):
    empty, out = small_frames / "belt_empty", tmp_path / "belt.json"
    code, text, err = run("measure", "belt", empty, "--out", out)
    assert code == 0
    assert f"{empty}: the empty belt's left end was not seen" in "\n".join(err)
    assert "--width MM" in "\n".join(err)
    assert "ends   left out of view, right out of view" in text
    code, text, _ = run("measure", "belt", empty, "--width", 400, "--out", out, "--json")
    result = parse_json(text)
    assert result["ends"] == ["told", "told"]
    assert result["width_mm"] == pytest.approx(400, abs=1)
    assert result["width_given_mm"] == 400
    code, text, err = run("measure", "belt", empty, "--across", -150, 160, "--out", out, "--json")
    assert parse_json(text)["across_mm"] == [-150, 160]
    assert "was not seen" not in "\n".join(err)
    (tmp_path / "region.txt").write_text("60,20\n250,20\n250,230\n60,230\n")
    code, text, _ = run("measure", "belt", empty, "--region", tmp_path / "region.txt", "--out", out, "--json")
    narrow = parse_json(text)
    assert narrow["ends"] == ["told", "told"]
    page = out.with_suffix(".html").read_text()
    assert "What was taken as belt" in page
    assert "The left end, at the smaller x: told" in page


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--width", 2), "--width 2: must be greater than or equal to 50"),
        (("--across", 5, -5), "--across 5 -5"),
        (("--region", "1,2 3,4"), "has 2 corners; a polygon needs at least 3"),
        (("--region", "1,2 3,x 5,6"), "'3,x' is no pair u,v of pixels"),
        (("--region", "missing.txt"), "neither pairs"),
        (("--region", "5000,0 5100,0 5100,90"), "hardly anything was measured in the region"),
    ],
)
def test_wrong_widths_ends_and_regions_are_refused_in_one_line(run, small_frames, tmp_path, options, words):
    code, _, err = run("measure", "belt", small_frames / "belt_empty", *options, "--out", tmp_path / "b.json")
    assert code == 2
    assert words in "\n".join(err)
    assert not (tmp_path / "b.json").exists()


def test_picture_shows_the_belt_and_its_ends(small_frames):
    belt, depth = measure_empty_belt(
        small_frames / "belt_empty", None, Silent(), GivenBelt(across_mm=(-150, 160))
    )
    picture = make_belt_panel(belt, depth, require_camera(belt)).image.astype(int)
    blue = picture[..., 2] - picture[..., 0] > 40
    orange = (picture == [240, 130, 0]).all(axis=-1)
    points = belt.belt_from_core.apply(depth.points_mm(require_camera(belt)))
    inside = (points[..., 0] > -145) & (points[..., 0] < 155)
    outside = (points[..., 0] < -160) | (points[..., 0] > 170)
    assert blue[inside & ~orange].mean() > 0.95
    assert blue[outside].mean() < 0.01
    assert orange.any(axis=1).mean() > 0.5


def test_region_needs_depth_maps_and_other_given_ends_limit_a_belt_json(small_frames, tmp_path):
    belt, depth = measure_empty_belt(small_frames / "belt_empty", None, Silent())
    write_belt_files(tmp_path / "belt.json", belt, depth)
    limited, _ = read_empty_belt(tmp_path / "belt.json", Silent(), GivenBelt(across_mm=(-100, 90)))
    assert limited.across_mm == (-100, 90)
    with pytest.raises(InputError, match=r"belt\.json: region_px needs the depth maps"):
        read_empty_belt(tmp_path / "belt.json", Silent(), GivenBelt(region_px=((0, 0), (9, 0), (9, 9))))
