"""Scores of a fused belt against the true heights of its heap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.core.errors import InputError
from beltscape.core.geometry.pose import Pose, rotation_from_vector
from beltscape.core.height_map import HeightMap
from beltscape.evaluate.belt_scores import TrueBelt, compute_true_cells, read_true_belt, score_belt
from beltscape.files.arrays import write_arrays
from beltscape.files.fused_belt import FusedBelt
from beltscape.files.json_text import write_json
from beltscape.files.tiff import write_float_tiff

CELL_MM = 4.0
X_MM, S_MM = -60 + CELL_MM * np.arange(30), -100 + CELL_MM * np.arange(60)
POSITIONS_MM = {"000": -80.0, "001": 15.0, "002": 110.0}
HEAP_MM = {"000": -90.0, "001": 5.0, "002": 100.0}
"""The heap is where the belt is, but for the origins."""
TURN = Pose.of(rotation_from_vector(np.array([0.0, 0.0, 0.3])), (7.0, -4.0, 0.0))
"""From the world to the core: the belt frame lies turned in the world."""


def heap(x_mm, y_mm):
    return 40 + 25 * np.sin(x_mm / 21) * np.cos(y_mm / 17)


def make_pair(direction: int) -> tuple[FusedBelt, TrueBelt]:
    """Return an exact fused belt, and its truth on a fine grid."""
    heaps = {name: direction * mm for name, mm in HEAP_MM.items()}
    x, y = (np.arange(-300.0, 300.0) for _ in range(2))
    truth = TrueBelt(x, y, heap(*np.meshgrid(x, y)), heaps, TURN)
    height = np.empty((len(S_MM), len(X_MM)))
    for row, s in enumerate(S_MM):
        frame = min(POSITIONS_MM, key=lambda name: abs(POSITIONS_MM[name] - s))
        points = np.zeros((len(X_MM), 3))
        points[:, 0], points[:, 1] = X_MM, direction * (POSITIONS_MM[frame] - s)
        world = TURN.inverse().apply(points)
        height[row] = heap(world[:, 0], world[:, 1] - heaps[frame])
    heights = HeightMap(height, np.full_like(height, 0.5), (X_MM[0], S_MM[0]), CELL_MM)
    fused = FusedBelt(heights, np.ones_like(height), Pose.identity(), direction, POSITIONS_MM, (-90.0, 120.0))
    return fused, truth


@pytest.mark.parametrize("direction", [1, -1])
def test_an_exact_belt_has_no_error(direction):
    score = score_belt(*make_pair(direction))
    assert score.cells == len(X_MM) * np.count_nonzero((S_MM >= -90) & (S_MM <= 120))
    assert (score.measured, score.within_1mm, score.gross) == (1, 1, 0)
    assert score.median_mm < 0.15  # the mean over a cell is not the height at its middle
    assert abs(score.bias_mm) < 0.05
    assert np.isnan(score.filled_bias_mm)


def test_each_score_counts_what_it_says():
    fused, truth = make_pair(1)
    rng = np.random.default_rng(0)
    height = fused.heights.height_mm + rng.normal(0, 0.5, fused.heights.height_mm.shape)
    height[:, :3] += 8  # a tenth of the cells, filled too high
    measured = np.ones_like(height)
    measured[:, :3] = 0.2
    height[:, 3:6] += 6
    noisy = replace(fused, heights=replace(fused.heights, height_mm=height), measured=measured)
    score = score_belt(noisy, truth)
    assert score.measured == pytest.approx(0.9)
    assert score.gross == pytest.approx(0.2, abs=0.01)
    assert score.measured_gross == pytest.approx(1 / 9, abs=0.01)
    assert score.within_1mm == pytest.approx(0.8 * 0.954, abs=0.02)
    assert score.filled_bias_mm == pytest.approx(8, abs=0.1)
    assert score.bias_mm == pytest.approx(1.4, abs=0.05)
    assert 0.8 < score.sigma_ratio_low < score.sigma_ratio_high < 1.25


def test_steps_and_visible_cells_are_scored_apart():
    fused, truth = make_pair(1)
    high = np.where(truth.x_mm % 40 < 20, truth.height_mm, truth.height_mm + 50)
    stepped = replace(truth, height_mm=high)
    score = score_belt(fused, stepped, HalfCeiling())
    true_mm, _ = compute_true_cells(fused, stepped)
    assert 0.1 < score.steps < 0.3
    assert score.level_gross == pytest.approx(0.5, abs=0.06)
    assert score.visible == pytest.approx(0.5, abs=0.02)
    left = np.broadcast_to(fused.heights.x_mm < 0, true_mm.shape)
    counted = (S_MM >= -90) & (S_MM <= 120)
    error = np.abs(fused.heights.height_mm - true_mm)
    assert score.visible_gross == pytest.approx(np.mean(error[counted][left[counted]] > 5), abs=0.03)
    assert score.visible_measured == 1


class HalfCeiling:
    """Everything on one side of the belt is visible; the belt frame lies turned in the world."""

    def find_measurable(self, x_mm, y_mm, frames):
        """Return what lies at negative x of the belt frame."""
        assert set(frames) == set(POSITIONS_MM)
        return x_mm * TURN.rotation[0, 0] < -TURN.translation_mm[0]


def test_a_belt_that_is_placed_wrongly_shows_it():
    fused, truth = make_pair(1)
    shifted = replace(fused, positions_mm={name: mm + 3 for name, mm in POSITIONS_MM.items()})
    assert score_belt(shifted, truth).within_1mm < 0.5


def test_bare_belt_does_not_count():
    fused, truth = make_pair(1)
    low = np.where(truth.x_mm < 0, 1.0, truth.height_mm)
    assert 0.3 < score_belt(fused, replace(truth, height_mm=low)).cells / score_belt(fused, truth).cells < 0.7


def test_another_captures_truth_is_refused():
    fused, truth = make_pair(1)
    with pytest.raises(InputError, match="no frame of the flow is one of the truth's"):
        score_belt(fused, replace(truth, heap_mm={"900": 0.0}))
    with pytest.raises(InputError, match="no loaded cell"):
        score_belt(fused, replace(truth, y_mm=truth.y_mm + 5000))


@pytest.fixture
def folders(tmp_path):
    """A flow's folder and a truth's, as the commands write them."""
    fused, truth = make_pair(-1)
    flow, true = tmp_path / "flow", tmp_path / "truth"
    for folder in (flow, true):
        folder.mkdir()
    planes = (fused.heights.height_mm, fused.heights.sigma_mm, fused.measured)
    for name, plane in zip(("belt", "belt_sigma", "belt_measured"), planes, strict=True):
        write_float_tiff(flow / f"{name}.tiff", plane.astype(np.float32))
    pose = {"rotation": np.eye(3), "translation_mm": np.zeros(3)}
    grid = {"origin_mm": fused.heights.origin_mm, "cell_mm": CELL_MM, "belt_from_core": pose}
    strips = [
        {"start_mm": -90.0, "end_mm": 30.0, "quality": "valid"},
        {"start_mm": 30.0, "end_mm": 120.0, "quality": "degraded"},
        {"start_mm": 120.0, "end_mm": 900.0, "quality": "missing"},
    ]
    places = [{"frame": name, "position_mm": mm} for name, mm in POSITIONS_MM.items()]
    document = {"belt_grid": grid, "strips": strips, "places": places, "direction": "-y"}
    write_json(flow / "flow.json", document)
    write_arrays(true / "belt_moving_load.npz", x_mm=truth.x_mm, y_mm=truth.y_mm, height_mm=truth.height_mm)
    frames = [{"frame": name, "heap_mm": mm} for name, mm in truth.heap_mm.items()]
    write_json(true / "belt_moving.json", {"frames": frames})
    turn = {"rotation": TURN.rotation, "translation_mm": TURN.translation_mm}
    write_json(true / "station.json", {"core_from_world": turn})
    return flow, true


def test_the_command_says_it_in_a_few_lines(folders, capsys):
    flow, true = folders
    assert main(["evaluate", "belt", str(flow), "--truth", str(true)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("loaded   1590 cells of 4.0 mm, 100.0% measured")
    assert "100.0% within 1 mm" in lines[1]
    assert lines[2].startswith("ceiling  – visible and lit")  # nothing says what the cameras could see
    assert lines[3].startswith("level    100.0% without a step above 10 mm; of these 100.0% within 1 mm")
    assert lines[4].endswith("– of the filled")


def test_a_scenario_that_cannot_be_read_is_named(folders, capsys):
    flow, true = folders
    write_json(true / "scenario.json", {"kind": "no scene"})
    assert main(["evaluate", "belt", str(flow), "--truth", str(true)]) == 2
    assert "scenario.json: is no scenario of this program" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("flow.json", "give the --out folder of beltscape measure flow"),
        ("belt_sigma.tiff", "belt_sigma.tiff"),
    ],
)
def test_a_flow_that_lacks_a_file_is_named(folders, capsys, name, says):
    flow, true = folders
    (flow / name).unlink()
    assert main(["evaluate", "belt", str(flow), "--truth", str(true)]) == 2
    assert says in capsys.readouterr().err


def test_what_earlier_programs_wrote_is_refused(folders, capsys):
    flow, true = folders
    write_json(flow / "flow.json", {"belt_grid": {}, "strips": [], "places": [], "direction": "+y"})
    assert main(["evaluate", "belt", str(flow), "--truth", str(true)]) == 2
    assert "measure the flow again" in capsys.readouterr().err
    pose = {"rotation": np.eye(3), "translation_mm": np.zeros(3)}
    grid = {"origin_mm": [0, 0], "cell_mm": CELL_MM, "belt_from_core": pose}
    write_json(flow / "flow.json", {"belt_grid": grid, "strips": [], "places": [], "direction": None})
    assert main(["evaluate", "belt", str(flow), "--truth", str(true)]) == 2
    assert "no belt was counted in it" in capsys.readouterr().err
    write_arrays(true / "belt_moving_load.npz", y_mm=np.zeros(3), area_mm2=np.zeros(3))
    with pytest.raises(InputError, match="simulate the scene again"):
        read_true_belt(true)
