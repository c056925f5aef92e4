"""Budgets of uncertainty: independent effects by type A and B, combined by the GUM (JCGM 100:2008).

An effect is one source of error with its own σ and degrees of freedom. It may act on several quantities; these are
then correlated, and the effect adds linearly in any combination of them. Effects add in squares.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Kind = Literal["A", "B"]
"""By statistics of repeated observations, or by other knowledge (GUM 2.3.2, 2.3.3)."""
Numbers = NDArray[np.float64]
INFINITE = math.inf
"""Degrees of freedom of a σ that is taken as exact (GUM G.4.3)."""

_ROUNDING = 1e-9
"""Share of the largest contribution below which one is rounding of the inverses: these keep some ten digits."""


@dataclass(frozen=True, slots=True)
class Effect:
    """One source of error, independent of all others."""

    key: str
    """Its name, such as "repeatability"."""
    kind: Kind
    sigma: float
    """One standard deviation, in its own unit."""
    degrees_of_freedom: float = INFINITE
    sensitivity: Mapping[str, float] = field(default_factory=dict[str, float])
    """By the quantity that it acts on: change of the quantity for a change of the effect by one unit of ``sigma``."""


@dataclass(frozen=True, slots=True)
class Contribution:
    """The part of an effect in one result."""

    key: str
    kind: Kind
    sigma: float
    """One standard deviation of the result that is due to the effect alone; not negative."""
    degrees_of_freedom: float


@dataclass(frozen=True, slots=True)
class Budget:
    """The uncertainty of one result."""

    contributions: tuple[Contribution, ...]
    """The largest first."""
    sigma: float
    """Combined standard uncertainty."""
    degrees_of_freedom: float
    """Effective ones, by Welch and Satterthwaite (GUM G.4.1)."""
    confidence: float
    """Probability of the expanded interval, such as 0.95."""
    coverage_factor: float
    """Of Student's distribution (GUM G.3)."""

    @property
    def expanded(self) -> float:
        """Return the half width of the interval that holds the value with the probability ``confidence``."""
        return self.coverage_factor * self.sigma

    def select_sigma(self, kind: Kind) -> float:
        """Return the combined σ of the contributions of one type."""
        return math.sqrt(sum(one.sigma**2 for one in self.contributions if one.kind == kind))


def compute_effective_freedom(contributions: Sequence[Contribution]) -> float:
    """Return the effective degrees of freedom of independent contributions (Welch–Satterthwaite, GUM G.2b)."""
    variance = sum(one.sigma**2 for one in contributions)
    rest = sum(
        one.sigma**4 / one.degrees_of_freedom
        for one in contributions
        if math.isfinite(one.degrees_of_freedom)
    )
    return variance**2 / rest if rest > 0 else INFINITE


def compute_coverage_factor(degrees_of_freedom: float, confidence: float) -> float:
    """Return the two-sided factor k of Student's distribution; of the normal one for infinite degrees of freedom."""
    from scipy.special import ndtri, stdtrit

    share = (1 + confidence) / 2
    if not math.isfinite(degrees_of_freedom):
        return float(ndtri(share))
    return float(stdtrit(degrees_of_freedom, share))


def make_budget(contributions: Sequence[Contribution], confidence: float) -> Budget:
    """Return the budget of independent contributions, without those that are zero but for rounding."""
    least = _ROUNDING * max((one.sigma for one in contributions), default=0.0)
    found = sorted((one for one in contributions if one.sigma > least), key=lambda one: -one.sigma)
    freedom = compute_effective_freedom(found)
    return Budget(
        tuple(found),
        math.sqrt(sum(one.sigma**2 for one in found)),
        freedom,
        confidence,
        compute_coverage_factor(freedom, confidence),
    )


def combine_effects(effects: Sequence[Effect], weights: Mapping[str, float], confidence: float) -> Budget:
    """Return the budget of a linear combination of quantities with these weights.

    Effects that act on several of the quantities are added linearly over them (GUM 5.2.2), then in squares.
    """
    return make_budget(
        [
            Contribution(
                one.key,
                one.kind,
                abs(sum(weights.get(name, 0.0) * share for name, share in one.sensitivity.items()))
                * one.sigma,
                one.degrees_of_freedom,
            )
            for one in effects
        ],
        confidence,
    )


def build_covariance(effects: Sequence[Effect], quantities: Sequence[str]) -> Numbers:
    """Return the (n, n) float64 covariance of quantities on which the effects act."""
    covariance = np.zeros((len(quantities), len(quantities)))
    for one in effects:
        direction = one.sigma * np.array([one.sensitivity.get(name, 0.0) for name in quantities])
        covariance += np.outer(direction, direction)
    return covariance


@dataclass(frozen=True, slots=True, eq=False)
class LinearEstimate:
    """Parameters of a linear model by generalised least squares, where the data determine them."""

    weights: Numbers
    """(p, n) float64: each parameter as a combination of the observations; of least norm where undetermined."""
    values: Numbers
    """(p,) float64 parameters."""
    determined: Numbers
    """(p, p) float64 projector on the combinations of parameters that the observations determine."""
    chi_square: float
    """Squared residuals over their covariance; NaN without redundancy."""
    redundancy: int
    """ObservedRuns that are more than needed."""

    def is_determined(self, combination: Sequence[float]) -> bool:
        """Return whether the observations determine a linear combination of the parameters."""
        row = np.asarray(combination, np.float64)
        return bool(np.allclose(self.determined @ row, row, atol=1e-9))


def solve_linear(design: Numbers, observed: Numbers, covariance: Numbers) -> LinearEstimate:
    """Return the parameters (p,) of ``observed`` (n,) = ``design`` (n, p) @ parameters + errors.

    ``covariance`` (n, n) is that of the errors.

    A. C. Aitken 1935; combinations in the null space of the design are not determined and come out as zero.
    """
    inverse = np.linalg.pinv(covariance, hermitian=True)
    normal = design.T @ inverse @ design
    # relative to the scale of each parameter, so that σ of very different size do not look like a lost rank
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    pseudo = scale[:, None] * np.linalg.pinv(normal * np.outer(scale, scale), rcond=1e-12) * scale
    weights = pseudo @ design.T @ inverse
    values = weights @ observed
    rank = int(np.linalg.matrix_rank(design))
    residual = observed - design @ values
    redundancy = len(observed) - rank
    chi_square = float(residual @ inverse @ residual) if redundancy else math.nan
    determined = np.linalg.pinv(design) @ design
    return LinearEstimate(weights, values, determined, chi_square, redundancy)
