"""The verb ``bs.calibrate`` on the shipped board views."""

from __future__ import annotations

import numpy as np
import pytest

import beltscape as bs


@pytest.mark.thorough
def test_the_shipped_views_give_the_true_rig(rig, capsys):
    demo = bs.demo_folder()
    calibration = bs.calibrate(
        demo / "calibration", board=str(demo / "board.toml"), core="cam0", lens_model="brown"
    )
    assert repr(calibration).startswith("Calibration(Rig(core cam0, 5 cameras")
    assert calibration.score.rms_px < 0.05
    assert calibration.rig.core == "cam0"
    focal = calibration.rig.core_camera.focal_px
    np.testing.assert_allclose(focal, rig.core_camera.focal_px, rtol=2e-3)
    assert capsys.readouterr() == ("", "")
