"""Files of a speckle pattern: JSON, images and SVG."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.files.images import read_image
from beltscape.pipeline.pattern_files import write_pattern_files
from beltscape.target.pattern import PatternSettings, make_pattern
from beltscape.target.pattern_formats import draw_pattern, pattern_to_svg, read_pattern

PATTERN = make_pattern(PatternSettings(size_px=(160, 128), count=150, seed=7, grey=(0.2, 1)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pattern")
    write_pattern_files(folder, PATTERN)
    return folder


def test_pattern_is_read_as_it_was_written(folder):
    read = read_pattern(folder / "pattern.json")
    assert read.settings == PATTERN.settings
    assert read.markers == PATTERN.markers
    np.testing.assert_array_equal(read.dots, PATTERN.dots)
    np.testing.assert_array_equal(draw_pattern(read), draw_pattern(PATTERN))


def test_document_contains_the_settings(folder):
    document = json.loads((folder / "pattern.json").read_text())
    assert list(document) == ["format", "size_px", "seed", "parameters", "dots", "markers"]
    assert (document["format"], document["size_px"], document["seed"]) == (
        "beltscape-pattern/1",
        [160, 128],
        7,
    )
    assert None not in document["parameters"].values()
    assert document["markers"][6] == {"row": 1, "col": 2, "center_px": [99.5, 47.5], "radius_px": 8.0}
    assert len(document["dots"]) == 150
    again = make_pattern(
        PatternSettings(size_px=document["size_px"], seed=document["seed"], **document["parameters"])
    )
    np.testing.assert_array_equal(again.dots, document["dots"])


def test_files_are_deterministic(folder, tmp_path):
    files, _ = write_pattern_files(tmp_path, PATTERN)
    assert len(files) == 5
    for path in files.values():
        assert path.read_bytes() == (folder / path.name).read_bytes()


@pytest.mark.parametrize(
    ("bits", "image_format"),
    [
        (8, "png"),
        (16, "tiff"),
        *(pytest.param(*case, marks=pytest.mark.thorough) for case in ((16, "png"), (8, "tiff"))),
    ],
)
def test_image_file_contains_the_drawn_pattern(tmp_path, bits, image_format):
    files, _ = write_pattern_files(tmp_path, PATTERN, bits=bits, image_format=image_format)
    assert files["image"].name == f"pattern.{image_format}"
    np.testing.assert_array_equal(read_image(files["image"]), draw_pattern(PATTERN, bits))


def test_svg_contains_every_dot_and_marker_at_its_position():
    root = ET.fromstring(pattern_to_svg(PATTERN))
    assert root.attrib["viewBox"] == "-0.5 -0.5 160 128"
    circles = list(root.iter("{http://www.w3.org/2000/svg}circle"))
    got = np.array([[float(c.attrib[key]) for key in ("cx", "cy", "r")] for c in circles])
    markers = [(*m.center_px, m.radius_px) for m in PATTERN.markers]
    want = np.concatenate([PATTERN.dots[:, :3], markers])
    np.testing.assert_allclose(got[np.lexsort(got.T)], want[np.lexsort(want.T)], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("format"), "format is None, not 'beltscape-pattern/1'; give a pattern.json of"),
        (lambda d: d.pop("seed"), "seed is missing"),
        (lambda d: d["dots"].pop(), "149 dots, but parameters.count is 150; give the file as it was written"),
        (lambda d: d["dots"].insert(0, [1, 2, 3]), "dots[0][3] is missing"),
        (lambda d: d["markers"][2].update(row=4), "markers[2].row = 4: must be less than 4"),
        (
            lambda d: d["parameters"].update(d_min_px=None),
            "parameters.d_min_px = null: must be a number",
        ),
    ],
)
def test_mismatch_is_refused_by_name(folder, tmp_path, change, message):
    document = json.loads((folder / "pattern.json").read_text())
    change(document)
    path = tmp_path / "pattern.json"
    path.write_text(json.dumps(document))
    with pytest.raises(InputError) as error:
        read_pattern(path)
    assert str(error.value).startswith(f"{path}: {message}")


def test_other_json_is_refused(tmp_path):
    (tmp_path / "p.json").write_text("[1]")
    with pytest.raises(InputError, match="format is None"):
        read_pattern(tmp_path / "p.json")
