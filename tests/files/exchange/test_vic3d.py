"""VIC-3D projects: one as the program writes it, and the real one of the DICe example where available."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.geometry.pose import Pose, rotation_from_vector
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.exchange import detect_format, export_rig, import_rig

PROJECT = """<?xml version="1.0" encoding="ISO-8859-1"?>
<!DOCTYPE vpml>
<project dir="C:/Prüfung">
 <calibration lri="calibration">
  <camera id="0">955.5 645.25 6636 6637 0 1e-4 0.5 -20<orientation>180 0 0 -60 0.5 20</orientation>
  </camera>
  <camera id="1">971 615 6609 6610 7.05e-01 -5e-3 0 0<orientation>-180 -10 90 60 0.25 21</orientation>
  </camera>
 </calibration>
 <polygonmask width="1920" height="1200" lri="polygonmask"/>
</project>
"""


@pytest.fixture
def put(tmp_path):
    def put(text: str):
        path = tmp_path / "cal.xml"
        path.write_bytes(text.encode("latin-1"))
        return path

    return put


def test_a_project_is_read_about_its_first_camera(put):
    path, reporter = put(PROJECT), Silent()
    assert detect_format(path) == "vic3d"
    rig, kind = import_rig(path, reporter)
    assert (kind, rig.core, list(rig.cameras)) == ("vic3d", "cam0", ["cam0", "cam1"])
    camera = rig.cameras["cam0"]
    assert camera.size_px == (1920, 1200)
    np.testing.assert_array_equal(camera.center_px, [955.5, 645.25])
    np.testing.assert_array_equal(camera.focal_px, [6636, 6637])
    np.testing.assert_array_equal(camera.distortion, [1e-4, 0.5, 0, 0, -20])
    assert reporter.warnings == [
        f"{path}: cam1: its skew of 0.705 px is left out, which moves the image by up to 0.066 px"
    ]


def test_angles_rotate_about_x_then_y_then_z(put):
    rig, _ = import_rig(put(PROJECT), Silent())
    half = np.pi / 180
    about = [rotation_from_vector(np.array(v) * half) for v in ([-180.0, 0, 0], [0, -10.0, 0], [0, 0, 90.0])]
    first = Pose(rotation_from_vector(np.array([np.pi, 0, 0])), np.array([-60, 0.5, 20]))
    second = Pose(about[2] @ about[1] @ about[0], np.array([60, 0.25, 21]))
    expected = second @ first.inverse()
    np.testing.assert_allclose(rig.cam_from_core["cam1"].rotation, expected.rotation, atol=1e-12)
    np.testing.assert_allclose(rig.cam_from_core["cam1"].translation_mm, expected.translation_mm, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("6636 6637", "6636", r"camera cam0 = .*: must be 8 finite numbers"),
        ("180 0 0", "180 0", r"orientation of camera cam0 = .*: must be 6 finite numbers"),
        ("<camera id=\"1\"", "<camera id=\"0\"", r"two cameras are named 'cam0'; rename one"),
        ("<camera id=\"1\"", "<camera", r"camera has no id"),
        ("polygonmask", "aoi", r"no polygonmask has the size of the images; give a project XML with one"),
        ("width=\"1920\"", "width=\"wide\"", r"image width and height = .*: must be 2 finite numbers"),
        ("orientation>", "pose>", r"is none of opencv, .*, vic3d, .*, caliscope; give a calibration"),
        ("</project>", "", r"not XML \(no element found: line \d+, column \d+\)"),
    ],
)  # fmt: skip
def test_invalid_file_is_refused_in_one_line(put, old, new, line):
    assert old in PROJECT
    path = put(PROJECT.replace(old, new))
    with pytest.raises(InputError, match=line) as caught:
        import_rig(path, Silent())
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_format_is_read_only(put, tmp_path):
    rig: Rig = import_rig(put(PROJECT), Silent())[0]
    with pytest.raises(InputError, match="format 'vic3d' is read, not written; there are opencv, kalibr"):
        export_rig(tmp_path / "out.xml", rig, "vic3d", Silent())
