"""The cameras' delays measured from a swung board: a known skew is found with its σ, and the step passes or fails."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.detection.detect_capture import list_variants, make_two_sided_detector
from beltscape.cli.main import main
from beltscape.commissioning.runner import require_common_instant
from beltscape.commissioning.state import CommissionSettings
from beltscape.commissioning.trial import swing_board
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.geometry.pose import Pose
from beltscape.files.images import write_image
from beltscape.files.rig_json import write_rig
from beltscape.pipeline.calibrating.trigger_delay import estimate_delays
from beltscape.simulate.board_pictures import BoardPictures
from beltscape.target.board import corner_points_mm, read_board
from beltscape.target.planar_boards import SquareBoard
from tests.synthetic.demo import DEMO, choose_demo_rig, parse_json

RIG = choose_demo_rig(("cam0", "cam1", "cam3"), 1.0)
BOARD = read_board(DEMO / "board.toml")
assert isinstance(BOARD, SquareBoard)
POINTS = corner_points_mm(BOARD)
NONE = dict.fromkeys(RIG.cameras, 0.0)
SKEW_S = {"cam0": 0.0, "cam1": 1.5e-3, "cam3": -0.4e-3}
RATE_HZ, INSTANTS = 10.0, 24
BELT_MM_S = 2000.0
CORNER_PX = 0.05
"""σ of a corner's position, as detected in photographs."""


def detect(
    skew_s: Mapping[str, float], seed: int, instants: int = INSTANTS
) -> tuple[BoardDetections, dict[str, float]]:
    """Return exact corners with noise, as if they had been detected."""
    rng, views, times_s = np.random.default_rng(seed), {name: {} for name in RIG.cameras}, {}
    from beltscape.calibration.detection.corners import Corners

    for number in range(instants):
        frame, time_s = f"{number:03d}", number / RATE_HZ
        times_s[frame] = time_s
        for name, lens in RIG.cameras.items():
            pose = RIG.cam_from_core[name] @ swing_board(RIG, BOARD, time_s + skew_s[name])
            pixels = lens.project(pose.apply(POINTS)) + rng.normal(0, CORNER_PX, (len(POINTS), 2))
            seen = (pixels > 0).all(axis=1) & (pixels < np.array(lens.size_px) - 1).all(axis=1)
            if seen.sum() >= 8:
                views[name][frame] = Corners(np.flatnonzero(seen), pixels[seen])
    sizes = {name: lens.size_px for name, lens in RIG.cameras.items()}
    return BoardDetections(sizes, views, dict.fromkeys(sizes, instants)), times_s


def test_a_known_skew_is_found_within_its_sigma():
    errors = []
    for seed in range(12):
        detections, times_s = detect(SKEW_S, seed)
        found = estimate_delays(RIG, detections, times_s, POINTS, BELT_MM_S)
        assert set(found) == {"cam1", "cam3"}
        for name, delay in found.items():
            assert delay.sigma_ms < 0.05
            assert delay.displacement_mm == pytest.approx(delay.delay_ms * BELT_MM_S * 1e-3)
            errors.append((delay.delay_ms - 1e3 * SKEW_S[name]) / delay.sigma_ms)
    # the speed from five neighbours is right to 0.3 %, of 1.5 ms less than σ
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.6


def test_a_rig_that_is_a_little_wrong_is_no_skew():
    detections, times_s = detect(NONE, 1)
    bent = {**RIG.cam_from_core, "cam1": Pose.of([5e-4, -5e-4, 0], [0.3, 0.2, 0]) @ RIG.cam_from_core["cam1"]}
    wrong = type(RIG)(RIG.core, RIG.cameras, bent)
    for delay in estimate_delays(wrong, detections, times_s, POINTS, BELT_MM_S).values():
        assert abs(delay.delay_ms) < 4 * delay.sigma_ms


def test_a_board_at_rest_tells_nothing():
    detections, _ = detect(NONE, 0)
    still = {name: dict.fromkeys(views, views["005"]) for name, views in detections.views.items() if views}
    resting = BoardDetections(detections.sizes_px, still, detections.images)
    times_s = {frame: number / RATE_HZ for number, frame in enumerate(detections.frames)}
    with pytest.raises(CalibrationError, match="hardly moved"):
        estimate_delays(RIG, resting, times_s, POINTS, BELT_MM_S)
    few, times_s = detect(NONE, 0, instants=8)
    with pytest.raises(CalibrationError, match="10 are needed"):
        estimate_delays(RIG, few, times_s, POINTS, BELT_MM_S)


@pytest.fixture(scope="module")
def swung(tmp_path_factory) -> Path:
    """A capture of a swung board in which cam1 exposes 1.5 ms late and cam3 0.4 ms early."""
    folder = tmp_path_factory.mktemp("swung")
    grey = {name: np.full(lens.size_px[::-1], 90, np.uint8) for name, lens in RIG.cameras.items()}
    pictures, rows = BoardPictures(RIG, BOARD, grey), ["frame,timestamp_s"]
    for number in range(INSTANTS):
        time_s = number / RATE_HZ
        poses = {name: swing_board(RIG, BOARD, time_s + SKEW_S[name]) for name in RIG.cameras}
        for name, image in pictures.render(poses, number).items():
            write_image(folder / "moving_board" / name / f"{number:03d}.png", image)
        rows.append(f"{number:03d},{time_s}")
    (folder / "moving_board/times.csv").write_text("\n".join(rows) + "\n")
    write_rig(folder / "rig.json", RIG)
    return folder


def test_the_command_measures_it_from_images(swung, capsys):
    words = ["check", str(swung / "moving_board"), "--rig", str(swung / "rig.json")]
    words += ["--board", str(DEMO / "board.toml"), "--delays", str(BELT_MM_S)]
    assert main([*words, "--json"]) == 0
    delays = parse_json(capsys.readouterr().out)["delays"]
    for name in ("cam1", "cam3"):
        one = delays[name]
        assert one["sigma_ms"] < 0.03
        assert abs(one["delay_ms"] - 1e3 * SKEW_S[name]) < 4 * one["sigma_ms"]
    assert delays["cam1"]["belt_mm"] == pytest.approx(3.0, abs=0.1)
    assert main(words) == 0
    assert re.search(r"cam1 +\+1\.[45]\d+ ms ± ", capsys.readouterr().out)
    (swung / "moving_board/times.csv").rename(swung / "times.kept")
    try:
        assert main(words) == 2
        assert "has neither times.csv nor encoder.csv" in capsys.readouterr().err
    finally:
        (swung / "times.kept").rename(swung / "moving_board/times.csv")
    assert main([*words[:-1], "0"]) == 2
    assert "--delays" in capsys.readouterr().err


def make_delay(delay_ms: float, sigma_ms: float) -> dict[str, float]:
    return {
        "delay_ms": delay_ms,
        "sigma_ms": sigma_ms,
        "belt_mm": 2 * delay_ms,
        "sigma_mm": 2 * sigma_ms,
    }


def test_a_late_camera_fails_and_so_does_one_whose_delay_is_not_known_well_enough():
    settings = CommissionSettings()
    sound = {"cam1": make_delay(0.02, 0.01), "cam3": make_delay(-0.09, 0.03)}
    require_common_instant(sound, ("cam1", "cam3"), settings)
    for faults, said in (
        (
            {"cam1": make_delay(1.5, 0.02)},
            r"cam1: exposes 1\.5 ms ± 0\.02 ms after the core, 3 mm ± 0\.04 mm of belt",
        ),
        ({"cam1": make_delay(-0.3, 0.02)}, "before the core"),
        ({"cam1": make_delay(0.05, 0.2)}, "too coarse for skew_limit_ms = 0.1"),
    ):
        with pytest.raises(InputError, match=said):
            require_common_instant({**sound, **faults}, ("cam1", "cam3"), settings)
    with pytest.raises(InputError, match="cam4: did not see the board move"):
        require_common_instant(sound, ("cam1", "cam3", "cam4"), settings)


def test_pictures_of_a_board_show_its_corners_where_they_are():
    """To 0.007 px RMS, per axis; with a ray between fine texels 0.024 px, and 0.15 px at single corners."""
    detect_corners = make_two_sided_detector(BOARD, list_variants(BOARD)[0])
    grey = {name: np.full(lens.size_px[::-1], 90, np.uint8) for name, lens in RIG.cameras.items()}
    pictures, errors = BoardPictures(RIG, BOARD, grey), list[np.ndarray]()
    for time_s in (0.0, 0.7, 1.4):
        pose = swing_board(RIG, BOARD, time_s)
        for name, image in pictures.render(pose, 5).items():
            corners = detect_corners(image)
            assert corners is not None
            assert len(corners) > 40
            true = RIG.cameras[name].project((RIG.cam_from_core[name] @ pose).apply(POINTS[corners.ids]))
            errors.append(corners.pixels - true)
    off = np.concatenate(errors)
    assert np.sqrt(np.mean(np.square(off))) < 0.010
    assert np.abs(off.mean(axis=0)).max() < 0.002
    assert np.abs(off).max() < 0.08
    behind = Pose(pose.rotation @ np.diag([1.0, -1.0, -1.0]), pose.translation_mm)
    seen = pictures.render(behind, 5)
    assert all((image == 90).all() for image in seen.values()), "the back of the board is not shown"
