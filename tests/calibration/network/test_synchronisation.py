"""The check of synchronisation: shifted and shuffled frames are reported, synchronous ones are not."""

from __future__ import annotations

import pytest

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.core.errors import CalibrationError
from beltscape.core.progress import Silent
from tests.synthetic.detections import make_detections


def shift_frames(own: BoardDetections, camera: str, by: int) -> BoardDetections:
    """Return the detections with one camera's frames named ``by`` too high, cyclically."""
    names = sorted(own.views[camera])
    views = {names[(i + by) % len(names)]: own.views[camera][name] for i, name in enumerate(names)}
    return BoardDetections(own.sizes_px, {**own.views, camera: dict(sorted(views.items()))}, own.images)


@pytest.mark.parametrize(
    ("by", "text"),
    [
        pytest.param(1, "1 too high", marks=pytest.mark.thorough),
        (-1, "1 too low"),
        pytest.param(2, "2 too high", marks=pytest.mark.thorough),
    ],
)
def test_a_camera_whose_frames_are_shifted_is_reported_and_left_out(rig, board, poses, by, text):
    own = shift_frames(make_detections(rig, board, poses, 0.1), "c", by)
    reporter = Silent()
    chain = solve_hierarchy(own, board, rig.core, reporter)
    assert "c" not in chain.rig.cameras
    assert reporter.warnings == [
        f"camera c: its frame numbers are {text} against a, b, d; rename its images; going on without c"
    ]


def test_a_camera_whose_frames_are_shuffled_is_reported(rig, board, poses):
    own = make_detections(rig, board, poses, 0.1)
    names = sorted(own.views["c"])
    order = [7, 2, 10, 0, 5, 11, 3, 8, 1, 9, 4, 6]
    views = {name: own.views["c"][names[k]] for name, k in zip(names, order, strict=True)}
    reporter = Silent()
    chain = solve_hierarchy(
        BoardDetections(own.sizes_px, {**own.views, "c": views}, own.images), board, rig.core, reporter
    )
    assert "c" not in chain.rig.cameras
    assert reporter.warnings[0].startswith("camera c: its frames do not belong to those of a, b, d")


def test_a_shift_between_the_only_two_cameras_is_refused(rig, board, poses):
    own = make_detections(rig, board, poses, 0.1).restrict(("a", "b"), [f"{i:02d}" for i in range(12)])
    with pytest.raises(
        CalibrationError, match="camera b: its frame numbers are 1 too high against a; rename"
    ):
        solve_hierarchy(shift_frames(own, "b", 1), board, "a", Silent())


def test_synchronous_cameras_are_not_reported(rig, board, poses):
    reporter = Silent()
    chain = solve_hierarchy(make_detections(rig, board, poses, 0.3), board, rig.core, reporter)
    assert set(chain.rig.cameras) == set(rig.cameras)
    assert not reporter.warnings
