"""cameras.json: the types of a capture's cameras."""

from __future__ import annotations

import json

import pytest

from beltscape.core.errors import InputError
from beltscape.files.camera_types import FORMAT, CameraType, read_camera_types, write_camera_types
from beltscape.pipeline.recording.project import list_camera_types
from beltscape.sources.genicam.aravis import FoundCamera
from beltscape.sources.genicam.settings import CamerasSettings

TYPES = {"a": CameraType("maker C-5, 8 mm", "tilted"), "b": CameraType("maker C-5")}


def test_types_are_read_as_they_were_written(tmp_path):
    assert read_camera_types(tmp_path) == {}
    write_camera_types(tmp_path, TYPES)
    assert read_camera_types(tmp_path) == TYPES


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"format": "x"}, "format must be"),
        ({"cameras": []}, "cameras must be a table"),
        ({"cameras": {"a": 1}}, "cameras.a must be a table"),
        ({"cameras": {"a": {"lens": "x"}}}, "cameras.a.lens = 'x': only model and lens_model"),
        ({"cameras": {"a": {"model": 5}}}, "cameras.a.model = 5: only"),
        ({"cameras": {"a": {"lens_model": "wide"}}}, "cameras.a.lens_model = 'wide': must be one of brown"),
    ],
)
def test_an_invalid_file_is_refused(tmp_path, change, line):
    (tmp_path / "cameras.json").write_text(json.dumps({"format": FORMAT, "cameras": {}, **change}))
    with pytest.raises(InputError) as error:
        read_camera_types(tmp_path)
    assert line in str(error.value)


def test_the_project_goes_before_what_a_camera_states():
    settings = CamerasSettings(
        devices={"a": "10.0.0.2", "b": "4711", "c": "10.0.0.9"},
        models={"a": "C-5, 8 mm"},
        lens_models={"b": "tilted"},
    )
    found = [
        FoundCamera("M-1", "C-5", "maker", "10.0.0.2", "1", "GigE"),
        FoundCamera("M-2", "C-9", "maker", "", "4711", ""),
    ]
    assert list_camera_types(settings, found) == {
        "a": CameraType("C-5, 8 mm"), "b": CameraType("maker C-9", "tilted"), "c": CameraType()
    }  # fmt: skip
