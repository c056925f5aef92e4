"""belt.json: exact round trip and refused values."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.empty_belt import Belt, BeltDeviation, BeltEdges
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.files.belt_json import read_belt, write_belt

CAMERA = Camera("cam0", (64, 48), np.array([60.1, 60.2]), np.array([31.5, 23.5]), np.zeros(5))


def belt(*, full: bool = True) -> Belt:
    rng = np.random.default_rng(3)
    x = np.sort(rng.uniform(-300, 300, 7))
    deviation = BeltDeviation(x, x[:4], rng.normal(size=(4, 7)), rng.uniform(0, 1, (4, 7)))
    return Belt(
        belt_from_core=Pose.of(np.array([3.1, 0.01, 0.02]), np.array([1 / 3, 2.0, 740.0])),
        x_mm=x,
        z_mm=rng.normal(size=7),
        across_mm=(float(x[0]), float(x[-1])),
        flat_mm=(-100.0, 101.0) if full else None,
        flat_rms_mm=0.02,
        noise_mm=0.03,
        correlation_px=5.5,
        drift_mm=0.0,
        tilt_sigma_rad=1e-5,
        yaw_sigma_rad=2e-5 if full else None,
        yaw_from="shape",
        z_sigma_mm=rng.uniform(0, 1, 7),
        along_mm=(-200.0, 210.0),
        deviation=deviation if full else None,
        edges=BeltEdges(-300.0, np.nan, 0.5, np.nan, np.nan, np.nan, "trough") if full else None,
        claimed_sigma_mm=0.01,
        frames=4,
    )


@pytest.mark.parametrize("full", [True, False])
def test_the_round_trip_is_exact_and_stable_to_the_byte(tmp_path, full):
    write_belt(tmp_path / "a.json", belt(full=full), CAMERA)
    back, camera = read_belt(tmp_path / "a.json")
    write_belt(tmp_path / "b.json", back, camera)
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    np.testing.assert_array_equal(back.z_mm, belt().z_mm)
    np.testing.assert_array_equal(back.belt_from_core.translation_mm, belt().belt_from_core.translation_mm)
    np.testing.assert_array_equal(camera.focal_px, CAMERA.focal_px)
    if full:
        assert back.edges is not None
        assert np.isnan(back.edges.right_mm)


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (("format",), "beltscape-rig/1", "format is 'beltscape-rig/1', not 'beltscape-belt/1'"),
        (("units",), "m", "units = 'm': only \"mm\" is known"),
        (("frames",), 0, "frames = 0: must be a whole number of at least 1"),
        (("frames",), True, "frames = True: must be a whole number of at least 1"),
        (("across_mm",), ["-400", "400"], "across_mm must be 2 numbers"),
        (("quality", "noise_mm"), True, "quality.noise_mm must be a number"),
        (("section",), None, "section must be a table"),
        (("section", "x_mm"), [3, 2, 1], "section.x_mm must be two or more ascending numbers"),
        (("section", "z_mm"), [1, 2], "section.z_mm must be 7 numbers"),
        (("quality", "noise_mm"), "low", "quality.noise_mm must be a number"),
        (("belt_from_core", "rotation"), [[1, 0, 0]] * 3, "belt_from_core.rotation is not a rotation"),
        (("across_mm",), [2, 1], "across_mm = [2, 1]: the first number must be the smaller one"),
        (("edges", "against"), "wall", "edges.against = 'wall'"),
    ],
)
def test_invalid_value_is_named(tmp_path, place, value, words):
    path = tmp_path / "belt.json"
    write_belt(path, belt(), CAMERA)
    document = json.loads(path.read_text())
    table = document
    for key in place[:-1]:
        table = table[key]
    table[place[-1]] = value
    path.write_text(json.dumps(document))
    with pytest.raises(InputError) as caught:
        read_belt(path)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)


def test_ends_and_what_stands_beside_them_are_kept_and_unknown_in_earlier_files(tmp_path):
    known = replace(belt(), ends=("seen", "told"), clear_mm=(-np.inf, 412.5), width_mm=800.0)
    write_belt(tmp_path / "belt.json", known, CAMERA)
    back, _ = read_belt(tmp_path / "belt.json")
    assert (back.ends, back.clear_mm, back.width_mm) == (known.ends, known.clear_mm, 800.0)
    document = json.loads((tmp_path / "belt.json").read_text())
    for key in ("ends", "clear_mm", "width_mm", "sha256"):
        document.pop(key, None)
    (tmp_path / "old.json").write_text(json.dumps(document))
    old, _ = read_belt(tmp_path / "old.json")
    assert (old.ends, old.clear_mm, old.width_mm) == (None, (-np.inf, np.inf), None)


@pytest.mark.parametrize("ends", [["seen"], ["seen", "lost"], "seen", [1, 2]])
def test_unknown_kinds_of_ends_are_refused(tmp_path, ends):
    write_belt(tmp_path / "belt.json", belt(), CAMERA)
    document = json.loads((tmp_path / "belt.json").read_text())
    document["ends"] = ends
    (tmp_path / "belt.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"ends = .* must be two of seen, inferred, told"):
        read_belt(tmp_path / "belt.json")
