"""Repeated runs at several loads: scatter within a load, differences between loads, and tests of linearity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LoadMean:
    """The runs of one load."""

    name: str
    runs: int
    level: float
    """Mean of what tells the loads apart, such as the mean flow."""
    mean: float
    """Mean of the observed values."""
    sigma_run: float
    """Standard deviation of one run; NaN for a single run."""


@dataclass(frozen=True, slots=True)
class FTest:
    """A comparison of two variances by Fisher's distribution."""

    ratio: float
    """Between over within."""
    degrees_between: int
    degrees_within: int
    probability: float
    """Of such a ratio or a greater one by chance."""

    def is_significant(self, level: float) -> bool:
        """Return whether chance explains it with less than this probability."""
        return self.probability < level


@dataclass(frozen=True, slots=True)
class LineFit:
    """The straight line through the runs over the level of the load."""

    slope: float
    """Change of the value for one unit of the level."""
    slope_sigma: float
    lack_of_fit: FTest | None
    """Whether the loads lie farther from the line than the scatter explains; None for fewer than three loads."""


@dataclass(frozen=True, slots=True)
class Repeatability:
    """The evaluation of all runs of one kind."""

    loads: tuple[LoadMean, ...]
    mean: float
    """Mean over all runs."""
    sigma_run: float
    """Pooled standard deviation of one run within a load; NaN where every load has one run."""
    degrees_of_freedom: int
    """Of ``sigma_run``: runs less loads."""
    sigma_mean: float
    """Standard deviation of ``mean`` by the scatter alone."""
    linearity: FTest | None
    """Whether the loads differ by more than the scatter explains; None for one load or without repetitions."""
    line: LineFit | None
    """None for one load or without repetitions."""

    @property
    def largest_difference(self) -> float:
        """Return the greatest mean of a load less the least."""
        means = [one.mean for one in self.loads]
        return max(means) - min(means)


def evaluate_runs(names: Sequence[str], levels: Sequence[float], values: Sequence[float]) -> Repeatability:
    """Return the evaluation of runs: name and level of each one's load, and its value; every run counts alike.

    The scatter is pooled over the loads (GUM H.5.2.2, analysis of variance), because few runs of one load determine
    it badly.
    """
    value, level = np.asarray(values, np.float64), np.asarray(levels, np.float64)
    groups = [np.array([name == other for other in names]) for name in dict.fromkeys(names)]
    means = [_describe_load(name, level[own], value[own]) for name, own in _name_groups(names, groups)]
    within = float(sum(((value[own] - value[own].mean()) ** 2).sum() for own in groups))
    free = len(value) - len(groups)
    sigma = math.sqrt(within / free) if free else math.nan
    between = float(sum(own.sum() * (value[own].mean() - value.mean()) ** 2 for own in groups))
    tested = len(groups) > 1 and free > 0
    return Repeatability(
        tuple(means),
        float(value.mean()),
        sigma,
        free,
        sigma / math.sqrt(len(value)) if free else math.nan,
        compare_variances(between, len(groups) - 1, within, free) if tested else None,
        _fit_line(level, value, groups, within, free) if tested else None,
    )


def _name_groups(
    names: Sequence[str], groups: Sequence[NDArray[np.bool_]]
) -> list[tuple[str, NDArray[np.bool_]]]:
    return list(zip(dict.fromkeys(names), groups, strict=True))


def _describe_load(name: str, level: Numbers, value: Numbers) -> LoadMean:
    sigma = float(value.std(ddof=1)) if len(value) > 1 else math.nan
    return LoadMean(name, len(value), float(level.mean()), float(value.mean()), sigma)


def compare_variances(between: float, degrees_between: int, within: float, degrees_within: int) -> FTest:
    """Return the test of two sums of squares with their degrees of freedom."""
    from scipy.special import fdtrc

    if within <= 0:
        ratio = math.inf if between > 0 else 0.0
    else:
        ratio = (between / degrees_between) / (within / degrees_within)
    probability = float(fdtrc(degrees_between, degrees_within, ratio))
    return FTest(ratio, degrees_between, degrees_within, probability)


def _fit_line(
    level: Numbers, value: Numbers, groups: Sequence[NDArray[np.bool_]], within: float, free: int
) -> LineFit | None:
    """Return the line and its lack of fit (N. R. Draper, H. Smith 1998, section 2.1); None at one level."""
    apart = level - level.mean()
    spread = float(apart @ apart)
    if spread <= 0:
        return None
    slope = float(apart @ value / spread)
    fitted = value.mean() + slope * apart
    lacking = float(sum(own.sum() * (value[own].mean() - fitted[own].mean()) ** 2 for own in groups))
    test = compare_variances(lacking, len(groups) - 2, within, free) if len(groups) > 2 else None
    return LineFit(slope, math.sqrt(within / free / spread), test)
