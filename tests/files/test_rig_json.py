"""rig.json: exact round trip, keys of the contract, impossible rigs."""

from __future__ import annotations

import copy
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from beltscape.core.geometry.lens import MODELS
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.json_text import to_json
from beltscape.files.rig_json import read_rig, rig_document, write_rig
from beltscape.files.rig_limits import LEAST_BASELINE_MM
from tests.strategies import rigs


@given(rigs())
def test_the_round_trip_is_exact_and_stable_to_the_byte(tmp_path_factory, rig):
    folder = tmp_path_factory.getbasetemp()
    write_rig(folder / "a.json", rig)
    back = read_rig(folder / "a.json")
    write_rig(folder / "b.json", back)
    assert (folder / "a.json").read_bytes() == (folder / "b.json").read_bytes()
    assert (back.core, list(back.cameras)) == (rig.core, list(rig.cameras))
    for name, camera in rig.cameras.items():
        read, pose = back.cameras[name], back.cam_from_core[name]
        assert (read.name, read.size_px) == (name, camera.size_px)
        for key in ("focal_px", "center_px", "distortion"):
            np.testing.assert_array_equal(getattr(read, key), getattr(camera, key))
        np.testing.assert_array_equal(pose.rotation, rig.cam_from_core[name].rotation)
        np.testing.assert_array_equal(pose.translation_mm, rig.cam_from_core[name].translation_mm)


@given(rigs(), st.floats(0.01, 0.99), st.sampled_from(["metres", "fold", "focal"]))
def test_impossible_rig_is_not_read(tmp_path_factory, rig, share, fault):
    name = rig.auxiliaries[0]
    camera = rig.cameras[name]
    if fault == "metres":
        widest = max(np.linalg.norm(pose.center_mm) for pose in rig.cam_from_core.values())
        factor = share * LEAST_BASELINE_MM / widest
        poses = {n: Pose(p.rotation, factor * p.translation_mm) for n, p in rig.cam_from_core.items()}
        rig = replace(rig, cam_from_core=poses)
    elif fault == "fold":
        strength = -20 * (1 + share) * (camera.focal_px.mean() / np.hypot(*camera.size_px)) ** 2
        bent = replace(camera, distortion=np.array([strength, 0, 0, 0, 0]))
        rig = replace(rig, cameras={**rig.cameras, name: bent})
    else:
        short = replace(camera, focal_px=np.full(2, 0.1 * share * camera.size_px[0]))
        rig = replace(rig, cameras={**rig.cameras, name: short})
    path = tmp_path_factory.getbasetemp() / "implausible.json"
    write_rig(path, rig)
    with pytest.raises(InputError, match="cam"):
        read_rig(path)


def document() -> dict:
    """A rig.json of two cameras as another program might have written it."""
    camera = {
        "size_px": [640, 480],
        "focal_px": [800.0, 801.0],
        "center_px": [320.0, 240.0],
        "distortion": [-0.1, 0.01, 0.0, 0.0, 0.0],
        "cam_from_core": {
            "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            "translation_mm": [0.0, 0.0, 0.0],
        },
    }
    other = copy.deepcopy(camera)
    other["cam_from_core"]["translation_mm"] = [-100.0, 0.0, 0.0]
    return {
        "format": "beltscape-rig/1",
        "core": "cam0",
        "units": "mm",
        "cameras": {"cam0": camera, "cam1": other},
        "quality": {"held_out": {"rms_px": 0.1}},
        "covariance": {},
    }


def test_the_keys_are_those_of_the_contract_in_their_order(tmp_path):
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(document()))
    again = json.loads(to_json(rig_document(read_rig(path))))
    assert again == document()
    assert list(again) == ["format", "core", "units", "cameras", "quality", "covariance"]
    assert list(again["cameras"]["cam0"]) == list(document()["cameras"]["cam0"])


@pytest.mark.parametrize("model", MODELS)
def test_lens_models_are_read_and_written(tmp_path, model):
    values = document()
    lens = {
        "model": model,
        "distortion": [0.01 * (-1) ** i / (i + 1) for i in range(len(MODELS[model].coefficients))],
        "valid_radius_px": 380.5,
    }
    values["cameras"]["cam1"] = {**values["cameras"]["cam1"], **lens}
    (tmp_path / "rig.json").write_text(json.dumps(values))
    camera = read_rig(tmp_path / "rig.json").cameras["cam1"]
    assert (camera.model, camera.valid_radius_px) == (model, 380.5)
    np.testing.assert_array_equal(camera.distortion, lens["distortion"])
    again = json.loads(to_json(rig_document(read_rig(tmp_path / "rig.json"))))["cameras"]["cam1"]
    if model == "brown":
        del values["cameras"]["cam1"]["model"]  # files of before name none
    assert again == values["cameras"]["cam1"]


def test_quality_and_covariance_may_be_absent(tmp_path):
    values = document()
    del values["quality"], values["covariance"]
    (tmp_path / "rig.json").write_text(json.dumps(values))
    rig = read_rig(tmp_path / "rig.json")
    assert isinstance(rig, Rig)
    assert (rig.quality, rig.covariance) == ({}, {})


def test_not_measured_is_null(tmp_path):
    assert to_json({"a": [np.nan, np.inf, np.float64(1.5), np.int64(2)], "b": np.bool_(True)}) == (
        '{\n "a": [\n  null,\n  null,\n  1.5,\n  2\n ],\n "b": true\n}\n'
    )


GONE = object()
TURNED = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
MIRRORED = [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
SHEARED = [[1.0, 0.001, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
MEND = "; give a rig.json of beltscape calibrate"
POSE = "cameras.cam1.cam_from_core"


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        ("format", "kalibr/1", f"format is 'kalibr/1', not 'beltscape-rig/1'{MEND}"),
        ("format", GONE, f"format is None, not 'beltscape-rig/1'{MEND}"),
        ("units", "m", f"units = 'm': only \"mm\" is known{MEND}"),
        ("units", GONE, f"units is missing{MEND}"),
        ("core", GONE, f"core is missing{MEND}"),
        ("core", "cam9", f"core = 'cam9' is not among the cameras cam0, cam1{MEND}"),
        ("core", "cam1", f"cam_from_core of the core camera cam1 must be the identity{MEND}"),
        ("cameras", GONE, f"cameras is missing{MEND}"),
        ("cameras", [], f"cameras must be a table of cameras by name{MEND}"),
        ("cameras.cam1", 3, f"cameras.cam1 must be a table{MEND}"),
        ("cameras.cam1.focal_px", GONE, f"cameras.cam1.focal_px is missing{MEND}"),
        ("cameras.cam1.focal_px", [800, 0], f"cameras.cam1.focal_px = [800, 0]: must be positive{MEND}"),
        ("cameras.cam1.focal_px", 800, f"cameras.cam1.focal_px must be 2 numbers{MEND}"),
        ("cameras.cam1.focal_px", [800, "x"], f"cameras.cam1.focal_px must be 2 numbers{MEND}"),
        ("cameras.cam1.focal_px", ["800", "800"], f"cameras.cam1.focal_px must be 2 numbers{MEND}"),
        ("cameras.cam1.distortion", [0, 0, 0, 0, True], f"cameras.cam1.distortion must be 5 numbers{MEND}"),
        ("cameras.cam1.valid_radius_px", True, f"cameras.cam1.valid_radius_px must be a number{MEND}"),
        ("quality", "good", f"quality must be a table{MEND}"),
        ("covariance", [1], f"covariance must be a table{MEND}"),
        ("covariance", {"parameters": 3}, f"covariance.parameters must be a list of names{MEND}"),
        (
            "covariance",
            {"parameters": ["cam0.fx"], "matrix": [["1"]]},
            f"covariance.matrix must be 1×1 numbers, as its parameters are{MEND}",
        ),
        (
            "cameras.cam1.distortion",
            [0, 0, 0, 0],
            "cameras.cam1.distortion has 4 numbers, model brown takes 5: k1, k2, p1, p2, k3; 4 are those of "
            f'"model": "fisheye"{MEND}',
        ),
        (
            "cameras.cam1.distortion",
            [0] * 6,
            f"cameras.cam1.distortion has 6 numbers, model brown takes 5: k1, k2, p1, p2, k3{MEND}",
        ),
        (
            "cameras.cam1.model",
            "omnidirectional",
            "cameras.cam1.model = 'omnidirectional': must be one of brown, rational, thin_prism, tilted, fisheye"
            f"{MEND}",
        ),
        ("cameras.cam1.valid_radius_px", "far", f"cameras.cam1.valid_radius_px must be a number{MEND}"),
        ("cameras.cam1.valid_radius_px", -1, f"cameras.cam1.valid_radius_px = -1: must be positive{MEND}"),
        ("cameras.cam1.distortion", [0, 0, 0, 0, None], f"cameras.cam1.distortion must be 5 numbers{MEND}"),
        (
            "cameras.cam1.size_px",
            [640.5, 480],
            f"cameras.cam1.size_px = [640.5, 480]: must be two positive whole numbers{MEND}",
        ),
        ("cameras.cam1.cam_from_core", GONE, f"{POSE} is missing{MEND}"),
        (f"{POSE}.rotation", [1, 0, 0], f"{POSE}.rotation must be 3×3 numbers{MEND}"),
        (
            f"{POSE}.rotation",
            SHEARED,
            f"{POSE}.rotation is not a rotation (orthonormal, determinant +1){MEND}",
        ),
        (
            f"{POSE}.rotation",
            MIRRORED,
            f"{POSE}.rotation is not a rotation (orthonormal, determinant +1){MEND}",
        ),
        (f"{POSE}.translation_mm", GONE, f"{POSE}.translation_mm is missing{MEND}"),
        (
            "cameras.cam0.cam_from_core.rotation",
            TURNED,
            f"cam_from_core of the core camera cam0 must be the identity{MEND}",
        ),
    ],
)
def test_invalid_value_is_named_by_its_position(tmp_path, where, value, message):
    values = document()
    *parents, last = where.split(".")
    target = values
    for key in parents:
        target = target[key]
    if value is GONE:
        del target[last]
    else:
        target[last] = value
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(values))
    with pytest.raises(InputError) as error:
        read_rig(path)
    assert str(error.value) == f"{path}: {message}"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"[1, 2]", "format is None, not 'beltscape-rig/1'; give a rig.json of beltscape calibrate"),
        (b'{"format": ', "not JSON (line 1, column 12: Expecting value)"),
        (b"\xff\xfe\x00", "not UTF-8 text"),
        (b"", "not JSON (line 1, column 1: Expecting value)"),
    ],
)
def test_other_documents_are_refused(tmp_path, data, message):
    (tmp_path / "rig.json").write_bytes(data)
    with pytest.raises(InputError) as error:
        read_rig(tmp_path / "rig.json")
    assert str(error.value) == f"{tmp_path}/rig.json: {message}"


def test_missing_file_and_folder_are_refused_by_name(tmp_path):
    with pytest.raises(InputError) as missing:
        read_rig(tmp_path / "rig.json")
    with pytest.raises(InputError) as folder:
        read_rig(tmp_path)
    assert str(missing.value) == f"{tmp_path}/rig.json: no such file"
    assert str(folder.value) == f"{tmp_path}: cannot be read (Is a directory)"


def test_byte_order_mark_is_accepted(tmp_path):
    (tmp_path / "rig.json").write_bytes(b"\xef\xbb\xbf" + json.dumps(document()).encode())
    assert read_rig(tmp_path / "rig.json").core == "cam0"
