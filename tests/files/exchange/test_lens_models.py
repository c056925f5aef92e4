"""Lens models in other programs' formats: carried where a format has them, refused by name where not."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import MODELS
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.exchange import export_rig, import_rig

LENSES = {
    "brown": [-0.1, 0.02, 1e-3, -2e-3, 0.0],
    "rational": [0.9, -0.3, 0.001, -0.002, 0.02, 1.1, -0.1, 0.03],
    "thin_prism": [0.9, -0.3, 0.001, -0.002, 0.02, 1.1, -0.1, 0.03, 0.004, -0.001, -0.003, 0.002],
    "tilted": [-0.2, 0.1, 0.001, -0.002, 0.02, 0.1, -0.02, 0.03, 0.004, -0.001, -0.003, 0.002, 0.11, -0.07],
    "fisheye": [-0.03, 0.012, -0.008, 0.002],
}
CARRIED = {
    "opencv": tuple(MODELS),
    "kalibr": ("brown", "fisheye"),
    "colmap": ("brown", "rational", "fisheye"),
    "ros": ("brown", "rational", "fisheye"),
}
AWAY = Pose.of([0.1, -0.2, 0.05], [-250.0, 4.0, 9.0])


def make_rig(model: str) -> Rig:
    cameras = {
        name: Camera(
            name, (640, 480), np.array([410.0, 412.5]), np.array([319.25, 241.0]), np.array(lens), kind
        )
        for name, kind, lens in (("a", "brown", LENSES["brown"]), ("b", model, LENSES[model]))
    }
    return Rig("a", cameras, {"a": Pose.identity(), "b": AWAY})


@pytest.mark.parametrize("kind", CARRIED)
@pytest.mark.parametrize("model", LENSES)
def test_a_model_is_carried_or_refused(tmp_path, kind, model):
    rig, path = make_rig(model), tmp_path / ("out.json" if kind == "colmap" else "out.yaml")
    if model not in CARRIED[kind]:
        with pytest.raises(
            InputError, match=rf"camera b: \w+ has no lens model like {model}; calibrate with"
        ):
            export_rig(path, rig, kind, Silent())
        return
    reporter = Silent()
    export_rig(path, rig, kind, reporter)
    back, _ = import_rig(path, reporter)
    assert reporter.warnings == []
    for name, camera in rig.cameras.items():
        assert back.cameras[name].model == camera.model
        np.testing.assert_allclose(back.cameras[name].distortion, camera.distortion, rtol=1e-12)


def test_opencv_projects_a_fisheye_as_written(tmp_path):
    export_rig(tmp_path / "out.yaml", make_rig("fisheye"), "opencv", Silent())
    storage = cv2.FileStorage(str(tmp_path / "out.yaml"), cv2.FILE_STORAGE_READ)
    node = storage.getNode("cameras").at(1)
    assert node.getNode("fisheye_model").real() == 1
    k, d, r, t = (node.getNode(key).mat() for key in ("camera_matrix", "distortion_coefficients", "R", "T"))
    point = np.array([40.0, -30.0, 300.0])
    project = cv2.fisheye.projectPoints  # pyrefly: ignore[missing-attribute]
    seen, _ = project(point[None, None], cv2.Rodrigues(r)[0], t, k, d)
    rig = make_rig("fisheye")
    np.testing.assert_allclose(seen.ravel(), rig.cameras["b"].project(AWAY.apply(point)), atol=1e-8)


def test_coefficients_of_zero_make_the_smallest_model(tmp_path):
    rig = make_rig("tilted")
    for count, model in ((5, "brown"), (8, "rational"), (12, "thin_prism"), (14, "tilted")):
        lens = np.where(np.arange(14) < count, LENSES["tilted"], 0.0)
        export_rig(
            tmp_path / "out.yaml",
            replace(rig, cameras={**rig.cameras, "b": replace(rig.cameras["b"], distortion=lens)}),
            "opencv",
            Silent(),
        )
        camera = import_rig(tmp_path / "out.yaml", Silent())[0].cameras["b"]
        assert camera.model == model
        np.testing.assert_array_equal(camera.distortion, lens[:count])


def test_a_part_of_the_image_is_not_carried_in_silence(tmp_path):
    rig = make_rig("rational")
    limited = {**rig.cameras, "b": replace(rig.cameras["b"], valid_radius_px=280.0)}
    reporter = Silent()
    export_rig(tmp_path / "out.yaml", replace(rig, cameras=limited), "opencv", reporter)
    (warning,) = reporter.warnings
    assert "b up to 280 px from the principal point); only rig.json holds that" in warning
