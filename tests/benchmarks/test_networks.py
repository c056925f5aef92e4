"""Sets of networks at equal shares of gross errors: the shares by hand, and a set that is worse."""

from __future__ import annotations

import shutil
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from beltscape.learned.network import write_network
from beltscape.learned.registry import load_network
from tests.synthetic.demo import SMALL_CAMERAS, crop_demo_rig, read_cropped_frame, read_cropped_truth


@pytest.fixture(autouse=True)
def _path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))


def test_shares_at_gross_errors_by_hand() -> None:
    """Ten true pixels, two unmeasured; the surest gross error is the fifth, and a later one is accepted with it."""
    shares = import_module("networks").compute_shares_at_gross
    error = np.array([0.1, 0.1, 2.0, 0.1, 9.0, 0.1, 0.1, 0.1, np.nan, np.nan])
    confidence = np.linspace(0.99, 0.9, 10)
    assert shares(error, confidence, [0.0, 0.125, 0.13, 0.2, 1.0]) == [0.3, 0.6, 0.6, 0.6, 0.6]
    assert shares(error[::-1], confidence, [0.0, 0.3]) == [0.3, 0.6]
    assert shares(error[4:5], confidence[:1], [0.5, 1.0]) == [0.0, 0.0]


def test_a_set_whose_confidence_is_turned_around_is_worse_and_the_shipped_one_returns(tmp_path: Path) -> None:
    networks, captures = import_module("networks"), import_module("captures")
    true_mm = read_cropped_truth("belt_loaded").astype(np.float64)
    frame, whole = read_cropped_frame("belt_loaded", SMALL_CAMERAS), np.isfinite(true_mm)
    scene = captures.Scene("demo", crop_demo_rig(SMALL_CAMERAS), frame, true_mm, whole, ~whole)
    (tmp_path / "same").mkdir(), (tmp_path / "turned").mkdir()
    shutil.copyfile(networks.SHIPPED / "message_round_3.npz", tmp_path / "same" / "message_round_3.npz")
    shipped = load_network("message_round_3")
    last = shipped.layers[-1].copy()
    last[0] *= -1  # the logit of the confidence
    write_network(
        tmp_path / "turned" / "message_round_3.npz", replace(shipped, layers=(*shipped.layers[:-1], last))
    )
    sets = [None, tmp_path / "same", tmp_path / "turned"]
    rows = [row.split(" | ") for row in networks.compare(scene, sets, "standard", [0.02])]
    assert [row[1] for row in rows] == ["shipped", "same", "turned"]
    ours, same, turned = (float(row[2].strip("| %")) for row in rows)
    assert ours == same
    assert 0 < turned < ours - 1
    np.testing.assert_array_equal(load_network("message_round_3").layers[-1], shipped.layers[-1])
