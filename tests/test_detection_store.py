"""The store of detections gives what the detectors give, and computes each once."""

from __future__ import annotations

import numpy as np

from beltscape.calibration.detection import detect_capture
from beltscape.calibration.detection.detector import PrintVariant
from beltscape.files.images import read_image
from tests.detection_store import REAL, detect_anew, use_detection_store


def test_corners_are_those_of_the_detector_and_found_once(tmp_path, charuco_capture):
    board, variant = charuco_capture.board, PrintVariant()
    first, second = (read_image(path) for path in sorted((charuco_capture.folder / "cam0").iterdir())[:2])
    with use_detection_store(tmp_path):
        for image in (first, second, first):
            found = detect_capture.make_detector(board, variant)(image)
            expected = REAL["make_detector"](board, variant)(image)
            assert found is not None
            np.testing.assert_array_equal(found.ids, expected.ids)
            np.testing.assert_array_equal(found.pixels, expected.pixels)
        assert len(list(tmp_path.iterdir())) == 2
        detect_capture.make_detector(board, PrintVariant(legacy=True))(first)
        assert len(list(tmp_path.iterdir())) == 3
        with detect_anew():
            assert detect_capture.make_detector is REAL["make_detector"]
    assert detect_capture.make_detector is not REAL["make_detector"]  # the run's own store
