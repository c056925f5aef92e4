"""Damaged files of other programs: whatever is missing or of a wrong type is one line that names it."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.files.exchange import export_rig, import_rig
from tests.files.exchange.test_other_programs import make_rig, matrix
from tests.files.exchange.test_vic3d import PROJECT
from tests.thorough import THOROUGH

WRONG = [
    None,
    "text",
    7,
    -1.5,
    True,
    [],
    {},
    [1, 2],
    [[1, 2], [3]],
    [["a"]],
    {"a": 1},
    "",
    float("nan"),
    10**400,
]
"""Values of every kind in place of the right one."""


def list_places(document: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the keys that lead to every value of a document; of long lists of numbers to the first one."""
    yield place
    if isinstance(document, dict):
        for key, value in document.items():
            yield from list_places(value, (*place, key))
    elif isinstance(document, list):
        for i, value in enumerate(document[:1] if document and isinstance(document[0], float) else document):
            yield from list_places(value, (*place, i))


def damage(document: Any, place: tuple[Any, ...], value: Any, *, removed: bool) -> Any:
    """Return a copy with the value at a place replaced, or removed."""
    if not place:
        return value
    document = copy.deepcopy(document)
    at = document
    for key in place[:-1]:
        at = at[key]
    if removed:
        del at[place[-1]]
    else:
        at[place[-1]] = value
    return document


def make_caliscope() -> dict[str, Any]:
    entry = {
        "size": [1280, 720], "matrix": [[900.0, 0.0, 640.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]],
        "distortions": [0.0, 0.0, 0.0, 0.0, 0.0], "rotation": [0.0, 0.1, 0.0], "translation": [0.0, 0.0, 0.1],
        "ignore": False, "fisheye": False,
    }  # fmt: skip
    return {"cameras": {"0": entry, "1": copy.deepcopy(entry)}}


def make_mc_calib() -> dict[str, Any]:
    camera = {
        "camera_matrix": matrix(np.array([[900.0, 0, 640], [0, 900, 360], [0, 0, 1]])),
        "distortion_vector": matrix(np.zeros((1, 5))), "distortion_type": 0, "camera_group": 0,
        "img_width": 1280, "img_height": 720, "camera_pose_matrix": matrix(np.eye(4)),
    }  # fmt: skip
    return {"nb_camera": 2, "units": "mm", "camera_0": camera, "camera_1": copy.deepcopy(camera)}


def make_stereo() -> dict[str, Any]:
    k, d = np.array([[900.0, 0, 640], [0, 900, 360], [0, 0, 1]]), np.zeros((1, 5))
    parts = {"M1": k, "D1": d, "M2": k, "D2": d, "R": np.eye(3), "T": np.array([[-100.0], [0], [0]])}
    lenses = {key: matrix(value) for key, value in parts.items()}
    return {**lenses, "units": "mm", "image_width": 1280, "image_height": 720}


def write_own(tmp_path: Path, kind: str) -> dict[str, Any]:
    """Return the documents, by file, of a rig that is exported to a format."""
    target = tmp_path / {"ros": "ros", "colmap": "rig.json"}.get(kind, "rig.yaml")
    files = export_rig(target, make_rig("cam0", "cam1"), kind, Silent())
    loader = json.loads if kind == "colmap" else load_yaml
    return {
        file.name if kind == "ros" else f"{file.stem}.json": loader(file.read_text()) for file in files
    }  # JSON is parsed fifty times as fast


def load_yaml(text: str) -> Any:
    return yaml.safe_load(text.replace("%YAML 1.2\n---\n", "").replace("!!opencv-matrix", ""))


def write(folder: Path, name: str, document: Any) -> Path:
    text = json.dumps(document) if name.endswith("json") else yaml.safe_dump(document)  # pyrefly: ignore[missing-attribute]
    (folder / name).write_text(text)
    return folder / name


def refuse_or_read(path: Path, kind: str) -> None:
    """Import a file; any exception but InputError fails the test."""
    try:
        import_rig(path, Silent(), kind=kind)
    except InputError as error:
        line = str(error)
        assert "\n" not in line
        assert not any(word in line for word in ("Error", "object", "NoneType", "unhashable", "'dict'"))


@pytest.mark.parametrize(
    "kind", ["caliscope", "mc-calib", "opencv-stereo", "opencv", "kalibr", "colmap", "ros"]
)
def test_whatever_is_damaged_in_a_file_is_named_in_one_line(tmp_path, kind):
    made = {"caliscope": make_caliscope, "mc-calib": make_mc_calib, "opencv-stereo": make_stereo}
    documents = {"file.json": made[kind]()} if kind in made else write_own(tmp_path, kind)
    folder = tmp_path / "damaged"
    folder.mkdir()
    for name, document in documents.items():
        write(folder, name, document)
    path = folder if kind == "ros" else folder / next(iter(documents))
    import_rig(path, Silent(), kind=kind)
    for name, document in documents.items():
        if name == "cam1.yaml" and not THOROUGH:
            continue  # as the first camera's
        for number, place in enumerate(list_places(document)):
            for value in WRONG if THOROUGH else WRONG[number % 7 :: 7]:
                write(folder, name, damage(document, place, value, removed=False))
                refuse_or_read(path, kind)
            if place:
                write(folder, name, damage(document, place, None, removed=True))
                refuse_or_read(path, kind)
        write(folder, name, document)


def test_whatever_is_missing_in_a_project_of_vic3d_is_named(tmp_path):
    lines = PROJECT.splitlines()
    for i in range(len(lines)):
        (tmp_path / "cal.xml").write_text("\n".join(lines[:i] + lines[i + 1 :]), "latin-1")
        refuse_or_read(tmp_path / "cal.xml", "vic3d")
    words = PROJECT.split(" ")
    for i in range(len(words)):
        for word in ("", "x", "nan", "1e999", "-1"):
            (tmp_path / "cal.xml").write_text(" ".join([*words[:i], word, *words[i + 1 :]]), "latin-1")
            refuse_or_read(tmp_path / "cal.xml", "vic3d")
