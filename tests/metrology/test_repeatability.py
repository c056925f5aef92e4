"""Scatter and linearity of repeated runs, by hand and by SciPy."""

from __future__ import annotations

import math

import pytest
from scipy import stats

from beltscape.metrology.repeatability import evaluate_runs

NAMES = ["low"] * 3 + ["mid"] * 3 + ["high"] * 3
LEVELS = [1.0] * 3 + [2.0] * 3 + [4.0] * 3
VALUES = [10.0, 12.0, 11.0, 14.0, 13.0, 15.0, 20.0, 19.0, 21.0]


def test_scatter_is_pooled_over_the_loads() -> None:
    """Within each load the squares add up to 2: s² = 6 / 6."""
    found = evaluate_runs(NAMES, LEVELS, VALUES)
    assert found.mean == pytest.approx(15)
    assert found.sigma_run == pytest.approx(1)
    assert found.degrees_of_freedom == 6
    assert found.sigma_mean == pytest.approx(1 / 3)
    assert [one.mean for one in found.loads] == pytest.approx([11, 14, 20])
    assert found.largest_difference == pytest.approx(9)


def test_linearity_is_the_analysis_of_variance() -> None:
    found = evaluate_runs(NAMES, LEVELS, VALUES)
    ratio, probability = stats.f_oneway(VALUES[:3], VALUES[3:6], VALUES[6:])
    assert found.linearity is not None
    assert found.linearity.ratio == pytest.approx(ratio)
    assert found.linearity.probability == pytest.approx(probability)
    assert (found.linearity.degrees_between, found.linearity.degrees_within) == (2, 6)
    assert found.linearity.is_significant(0.05)


def test_loads_on_a_line_do_not_lack_fit_and_others_do() -> None:
    """The means 11, 14, 20 at 1, 2, 4 lie on 8 + 3 x; with 14 raised to 17 they do not."""
    line = evaluate_runs(NAMES, LEVELS, VALUES).line
    assert line is not None
    assert line.slope == pytest.approx(stats.linregress(LEVELS, VALUES).slope)
    assert line.slope == pytest.approx(3)
    assert line.lack_of_fit is not None
    assert line.lack_of_fit.ratio == pytest.approx(0, abs=1e-20)
    assert line.lack_of_fit.probability == pytest.approx(1)
    bent = [value + 3 * (name == "mid") for name, value in zip(NAMES, VALUES, strict=True)]
    raised = evaluate_runs(NAMES, LEVELS, bent).line
    assert raised is not None
    assert raised.lack_of_fit is not None
    # the line through (1, 11), (2, 17), (4, 20) leaves -9/7, 27/14, -9/14; 3 × their squares, over s² = 1
    assert raised.lack_of_fit.ratio == pytest.approx(3 * ((9 / 7) ** 2 + (27 / 14) ** 2 + (9 / 14) ** 2))
    assert raised.lack_of_fit.is_significant(0.05)


def test_what_cannot_be_tested_is_not() -> None:
    single = evaluate_runs(["a", "b"], [1, 2], [5, 6])
    assert math.isnan(single.sigma_run)
    assert single.linearity is None
    assert single.line is None
    one_load = evaluate_runs(["a"] * 3, [1, 1, 1], [5, 6, 7])
    assert one_load.sigma_run == pytest.approx(1)
    assert one_load.linearity is None
    two = evaluate_runs(["a", "a", "b", "b"], [1, 1, 2, 2], [5, 6, 6, 7])
    assert two.line is not None
    assert two.line.lack_of_fit is None
