"""``evaluate lumps`` of a fused belt and of frames of a moving belt, against the rocks on top."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.core.geometry.pose import Pose
from beltscape.evaluate.belt_lump_scores import score_belt_lumps
from beltscape.evaluate.belt_scores import TrueBelt
from beltscape.files.arrays import write_arrays
from beltscape.files.json_text import write_json
from beltscape.measure.lumps.fused_belt import measure_belt_lumps
from beltscape.measure.lumps.settings import LumpSettings
from tests.synthetic.belts import S_MM, make_belt, write_belt_folder
from tests.synthetic.demo import parse_json

BALLS = [(-50.0, S_MM + 90 * number, 22.0 + 2 * number) for number in range(1, 6)]
SIZE_MM = np.array([2 * radius for *_, radius in BALLS])
VOLUME_MM3 = np.pi / 6 * SIZE_MM**3
ROWS = 300


def make_pair():
    """Return a belt, and its truth: y of the heap runs against s, from where the belt was at frame 000."""
    belt, which = make_belt(BALLS, ROWS)
    y = S_MM - belt.heights.y_mm[::-1]
    truth = TrueBelt(
        belt.heights.x_mm, y, belt.heights.height_mm[::-1], {"000": 0.0}, Pose.identity(), which[::-1]
    )
    return belt, truth


def test_all_balls_are_found_with_their_sizes():
    belt, truth = make_pair()
    lumps = measure_belt_lumps(belt.heights, belt.measured, LumpSettings(), belt.counted_mm)
    score = score_belt_lumps(lumps, belt, truth, SIZE_MM, VOLUME_MM3)
    assert (score.rocks, score.recall, score.precision) == (len(BALLS), 1, 1)
    assert score.d_mm == pytest.approx(score.d_top_mm, rel=0.1)
    assert score.d_mm[1] == score.d50_mm
    assert score.iou > 0.85


def test_a_truth_elsewhere_matches_nothing():
    belt, truth = make_pair()
    lumps = measure_belt_lumps(belt.heights, belt.measured, LumpSettings(), belt.counted_mm)
    assert truth.rock is not None
    turned = TrueBelt(
        truth.x_mm, truth.y_mm, truth.height_mm, truth.heap_mm, truth.core_from_world, truth.rock[:, ::-1]
    )
    assert score_belt_lumps(lumps, belt, turned, SIZE_MM, VOLUME_MM3).recall == 0


@pytest.fixture
def folders(tmp_path):
    """The folder of a flow, and of its truth."""
    belt, truth = make_pair()
    flow, true = tmp_path / "flow", tmp_path / "truth"
    write_belt_folder(flow, belt)
    assert truth.rock is not None
    write_arrays(
        true / "belt_moving_load.npz",
        x_mm=truth.x_mm, y_mm=truth.y_mm, height_mm=truth.height_mm, rock=truth.rock,
    )  # fmt: skip
    write_arrays(true / "belt_moving_rocks.npz", size_mm=SIZE_MM, volume_mm3=VOLUME_MM3)
    write_json(true / "belt_moving.json", {"frames": [{"frame": "000", "heap_mm": 0.0}]})
    pose = {"rotation": np.eye(3), "translation_mm": np.zeros(3)}
    write_json(true / "station.json", {"units": "mm", "core_from_world": pose})
    return flow, true


def test_the_command_scores_a_flow(folders, capsys):
    flow, true = folders
    assert main(["evaluate", "lumps", str(flow), "--truth", str(true), "--json"]) == 0
    score = parse_json(capsys.readouterr().out)
    assert (score["rocks"], score["recall"]) == (len(BALLS), 1)
    assert len(score["d_mm"]) == len(score["d_top_mm"]) == 4
    assert main(["evaluate", "lumps", str(flow), "--truth", str(true)]) == 0
    assert "d10–d90" in capsys.readouterr().out


def test_what_is_missing_is_one_line(folders, capsys):
    flow, true = folders
    arrays = np.load(true / "belt_moving_load.npz")
    write_arrays(
        true / "belt_moving_load.npz", **{name: arrays[name] for name in ("x_mm", "y_mm", "height_mm")}
    )
    assert main(["evaluate", "lumps", str(flow), "--truth", str(true)]) == 2
    assert "holds no rocks seen from above" in capsys.readouterr().err
    (true / "belt_moving_rocks.npz").unlink()
    assert main(["evaluate", "lumps", str(flow), "--truth", str(true)]) == 2
    assert "belt_moving_rocks.npz: no such file" in capsys.readouterr().err


def test_a_frame_that_is_not_of_the_truth_is_refused(folders, capsys, tmp_path):
    _, true = folders
    write_arrays(
        true / "belt_moving_depth.npz", depth_mm=np.ones((1, 4, 5)), rock=np.zeros((1, 4, 5), np.int32)
    )
    assert main(["evaluate", "lumps", str(tmp_path / "007"), "--truth", str(true)]) == 2
    assert "frames 000 to 000, not 007" in capsys.readouterr().err
