"""The material test: known masses or volumes against the measured volume; span factor, density and moisture apart.

The logarithms of all quantities are related linearly. V is the measured volume less the zero's, w the moisture::

    ln M / V     = ln span + ln dry density - ln (1 - w)     mean of the runs of known mass
    ln V0 / V    = ln span                                   mean of the runs of known volume
    ln density   =           ln dry density - ln (1 - w)     a weighed container of known volume
    ln (1 - w)   =                            ln (1 - w)     a dried sample

Masses alone determine the product of span factor and bulk density, which is what a mass needs, and neither of both.
What the observations determine follows from the rank of this model; nothing else is stated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beltscape.core.errors import MeasureError
from beltscape.metrology.observations import (
    REFERENCE_KINDS,
    ObservedRuns,
    ReferenceKind,
    ReferenceRun,
    ReferenceStandard,
    correct_volume,
)
from beltscape.metrology.repeatability import Repeatability, evaluate_runs
from beltscape.metrology.uncertainty import (
    INFINITE,
    Budget,
    Effect,
    LinearEstimate,
    build_covariance,
    combine_effects,
    make_budget,
    solve_linear,
)

SIGNIFICANCE = 0.05
"""Probability below which loads count as different, and observations as contradictory. Usual (GUM H.5)."""
_UNIFORM = 1 / math.sqrt(12)
"""σ of a value that lies anywhere in an interval of length 1 (GUM 4.3.7)."""
_PARAMETERS = ("span", "dry_density", "solids")
"""Logarithms of span factor, dry bulk density and share of solids."""
_DESIGN: Mapping[str, tuple[float, float, float]] = {
    "mass": (1.0, 1.0, -1.0),
    "volume": (1.0, 0.0, 0.0),
    "density": (0.0, 1.0, -1.0),
    "dry_density": (0.0, 1.0, 0.0),
    "moisture": (0.0, 0.0, 1.0),
}
"""What each observation is the sum of."""
_RESULTS: Mapping[str, tuple[float, float, float]] = {
    "mass_factor": (1.0, 1.0, -1.0),
    "span_factor": (1.0, 0.0, 0.0),
    "bulk_density": (0.0, 1.0, -1.0),
    "dry_density": (0.0, 1.0, 0.0),
    "moisture": (0.0, 0.0, 1.0),
}
"""What each result is the sum of. ``mass_factor``: kg per measured m³, span factor times bulk density."""


@dataclass(frozen=True, slots=True)
class Result:
    """One result with its budget; contributions and σ have the unit of the value."""

    key: str
    """"mass_factor" (kg/m³), "span_factor", "bulk_density", "dry_density" (kg/m³), "moisture" (share)."""
    value: float
    budget: Budget


@dataclass(frozen=True, slots=True)
class LoadResult:
    """A load's deviation from the mean of all loads of its kind, and how far both are known apart from each other."""

    name: str
    kind: ReferenceKind
    runs: int
    level: float
    deviation: float
    """Measured over reference, relative to the mean over all runs, less 1."""
    deviation_sigma: float
    """σ of it: the common part of the reference's error cancels."""
    sigma_run: float
    """Scatter of one run; NaN for a single run."""


@dataclass(frozen=True, slots=True)
class MaterialTest:
    """The evaluation of a material test."""

    observations: ObservedRuns
    results: tuple[Result, ...]
    """Those that are determined."""
    undetermined: tuple[str, ...]
    """Keys of the results that the observations do not determine."""
    volume_error: Result | None
    """Measured over true volume, less 1; None where the span factor is not determined."""
    mass_error: Result | None
    """Mass by the plant's own density over the known mass, less 1; None without such masses."""
    by_kind: Mapping[ReferenceKind, Repeatability]
    """The runs' ln (reference / measured)."""
    loads: tuple[LoadResult, ...]
    zero_share: Mapping[ReferenceKind, float]
    """Share of the measured volume that the zero takes, mean over the runs."""
    contradiction: float
    """Probability by chance of how far redundant observations disagree; NaN without redundancy."""

    def find(self, key: str) -> Result | None:
        """Return a result; None where it is not determined."""
        return next((one for one in self.results if one.key == key), None)


def evaluate_material_test(observed: ObservedRuns) -> MaterialTest:
    """Return the evaluation.

    Raises
    ------
    MeasureError
        Without repetitions, or where a run measured nothing.
    """
    kinds = [kind for kind in REFERENCE_KINDS if any(run.kind == kind for run in observed.runs)]
    by_kind: dict[ReferenceKind, Repeatability] = {}
    for kind in kinds:
        runs = _select(observed, kind)
        by_kind[kind] = evaluate_runs(
            [run.load for run in runs],
            [run.level for run in runs],
            [_log_ratio(run, observed) for run in runs],
        )
    if not any(one.degrees_of_freedom for one in by_kind.values()):
        raise MeasureError("material test: no load has two runs; repeat each load, three times or more")
    effects = list(_list_effects(observed, by_kind))
    estimate, names = _solve(observed, by_kind, effects)
    results = tuple(_list_results(observed, estimate, names, effects))
    found = {one.key for one in results}
    wanted = [key for key in _RESULTS if observed.samples or key not in ("dry_density", "moisture")]
    return MaterialTest(
        observed,
        results,
        tuple(key for key in wanted if key not in found),
        _find_volume_error(results),
        _find_mass_error(observed, effects),
        by_kind,
        tuple(_list_loads(observed, by_kind)),
        {kind: _compute_zero_share(_select(observed, kind), observed) for kind in kinds},
        _test_contradiction(estimate),
    )


def _select(observed: ObservedRuns, kind: str) -> list[ReferenceRun]:
    return [run for run in observed.runs if run.kind == kind]


def _compute_zero_share(runs: Sequence[ReferenceRun], observed: ObservedRuns) -> float:
    return 1 - float(np.mean([correct_volume(run, observed) / run.volume_m3 for run in runs]))


def _log_ratio(run: ReferenceRun, observed: ObservedRuns) -> float:
    volume = correct_volume(run, observed)
    if not volume > 0 or not run.reference > 0:
        name = f"{run.load} {run.label}".strip()
        raise MeasureError(
            f"material test: run {name}: measured {volume:.4g} m³ of {run.reference:g}; both must be above 0"
        )
    return math.log(run.reference / volume)


def _list_effects(observed: ObservedRuns, by_kind: Mapping[ReferenceKind, Repeatability]) -> Iterator[Effect]:
    """Yield all sources of error with what they change in the observations."""
    for kind in by_kind:
        yield _find_scatter(kind, observed, by_kind)
        yield from _list_reference_effects(kind, observed)
    zero = observed.zero
    if zero is not None:
        shares: dict[str, float] = {
            kind: float(
                np.mean(
                    [run.length_m * 1e-6 / correct_volume(run, observed) for run in _select(observed, kind)]
                )
            )
            for kind in by_kind
        }
        yield Effect(
            "zero",
            "A" if math.isfinite(zero.degrees_of_freedom) else "B",
            zero.sigma_mm2,
            zero.degrees_of_freedom,
            shares,
        )
    differences = [one.largest_difference for one in by_kind.values() if _is_bent(one)]
    if differences:
        # the error at a load between those of the test lies anywhere in the range of theirs
        yield Effect("nonlinearity", "B", _UNIFORM * max(differences), INFINITE, dict.fromkeys(by_kind, 1.0))
    for other in observed.others:
        yield Effect(
            other.name, other.kind, other.sigma_share, other.degrees_of_freedom, dict.fromkeys(by_kind, 1.0)
        )
    for name, sample in (observed.samples or {}).items():
        solids = 1 - sample.value if name == "moisture" else sample.value
        yield Effect(f"{name}_sample", "B", sample.sigma / solids, sample.degrees_of_freedom, {name: 1.0})


def _is_bent(one: Repeatability) -> bool:
    return one.linearity is not None and one.linearity.is_significant(SIGNIFICANCE)


def _find_scatter(
    kind: ReferenceKind, observed: ObservedRuns, by_kind: Mapping[ReferenceKind, Repeatability]
) -> Effect:
    """Return the effect of what varies from run to run.

    The scatter of the runs contains display steps and the measurement's own noise; where few runs scatter by chance
    less than these alone, they are taken instead. Runs of a kind without repetitions take the other kind's scatter.
    """
    runs, own = _select(observed, kind), by_kind[kind]
    reference = observed.references.get(kind, ReferenceStandard())
    steps = [
        math.hypot(math.sqrt(2 if kind == "mass" else 1) * _UNIFORM * reference.resolution / run.reference,
                   run.own_sigma_m3 / correct_volume(run, observed))
        for run in runs
    ]  # fmt: skip
    least = math.sqrt(sum(one**2 for one in steps)) / len(runs)
    source = own if own.degrees_of_freedom else max(by_kind.values(), key=lambda one: one.degrees_of_freedom)
    sigma = source.sigma_run / math.sqrt(len(runs))
    if sigma < least:
        return Effect(f"{kind}_steps", "B", least, INFINITE, {kind: 1.0})
    return Effect(f"{kind}_repeatability", "A", sigma, source.degrees_of_freedom, {kind: 1.0})


def _list_reference_effects(kind: ReferenceKind, observed: ObservedRuns) -> Iterator[Effect]:
    """Yield the errors of the reference, which all runs of a kind share."""
    reference = observed.references.get(kind, ReferenceStandard())
    freedom = reference.degrees_of_freedom
    if reference.sigma_share:
        yield Effect(f"{kind}_reference_share", "B", reference.sigma_share, freedom, {kind: 1.0})
    if reference.sigma_constant:
        share = float(np.mean([1 / run.reference for run in _select(observed, kind)]))
        yield Effect(f"{kind}_reference_constant", "B", reference.sigma_constant, freedom, {kind: share})


def _solve(
    observed: ObservedRuns,
    by_kind: Mapping[ReferenceKind, Repeatability],
    effects: Sequence[Effect],
) -> tuple[LinearEstimate, list[str]]:
    """Return the parameters by all observations, and the names of these."""
    values: dict[str, float] = {kind: one.mean for kind, one in by_kind.items()}
    for name, sample in (observed.samples or {}).items():
        values[name] = math.log(1 - sample.value if name == "moisture" else sample.value)
    names = list(values)
    design = np.array([_DESIGN[name] for name in names])
    return solve_linear(design, np.array(list(values.values())), build_covariance(effects, names)), names


def _list_results(
    observed: ObservedRuns,
    estimate: LinearEstimate,
    names: Sequence[str],
    effects: Sequence[Effect],
) -> Iterator[Result]:
    for key, row in _RESULTS.items():
        if not estimate.is_determined(row):
            continue
        weights = dict(zip(names, np.array(row) @ estimate.weights, strict=True))
        budget = combine_effects(effects, weights, observed.confidence)
        value = math.exp(float(np.array(row) @ estimate.values))
        result = Result(key, value, scale_budget(budget, value))
        yield replace(result, value=1 - value) if key == "moisture" else result


def scale_budget(budget: Budget, factor: float) -> Budget:
    """Return the budget of a multiple of the result."""
    parts = [replace(one, sigma=abs(factor) * one.sigma) for one in budget.contributions]
    return make_budget(parts, budget.confidence)


def _find_volume_error(results: Sequence[Result]) -> Result | None:
    span = next((one for one in results if one.key == "span_factor"), None)
    if span is None:
        return None
    return Result("volume_error", 1 / span.value - 1, scale_budget(span.budget, 1 / span.value**2))


def _find_mass_error(observed: ObservedRuns, effects: Sequence[Effect]) -> Result | None:
    """Return the error of the masses that the plant records, which need no density but its own."""
    runs = _select(observed, "mass")
    if not runs or not all(run.recorded_kg > 0 for run in runs):
        return None
    error = math.expm1(float(np.mean([math.log(run.recorded_kg / run.reference) for run in runs])))
    without_zero = [
        one for one in effects if one.key != "zero"
    ]  # the recorded masses are not corrected for it
    budget = combine_effects(without_zero, {"mass": 1.0}, observed.confidence)
    return Result("mass_error", error, scale_budget(budget, 1 + error))


def _list_loads(
    observed: ObservedRuns, by_kind: Mapping[ReferenceKind, Repeatability]
) -> Iterator[LoadResult]:
    """Yield every load's deviation; the reference's error in proportion is the same for all loads and cancels."""
    for kind, own in by_kind.items():
        runs, total = _select(observed, kind), sum(one.runs for one in own.loads)
        constant = observed.references.get(kind, ReferenceStandard()).sigma_constant
        zero = 0.0 if observed.zero is None else observed.zero.sigma_mm2 * 1e-6
        for load in own.loads:
            mine = [run for run in runs if run.load == load.name]
            # what a common error does to this load, less what it does to the mean of all
            by_constant = _mean_inverse(mine) - _mean_inverse(runs)
            by_zero = _mean_length(mine, observed) - _mean_length(runs, observed)
            scatter = (
                own.sigma_run * math.sqrt(max(1 / load.runs - 1 / total, 0.0)) if total > load.runs else 0.0
            )
            sigma = math.hypot(np.nan_to_num(scatter), constant * by_constant, zero * by_zero)
            yield LoadResult(
                load.name,
                kind,
                load.runs,
                load.level,
                math.expm1(own.mean - load.mean),
                sigma,
                load.sigma_run,
            )


def _mean_inverse(runs: Sequence[ReferenceRun]) -> float:
    return float(np.mean([1 / run.reference for run in runs]))


def _mean_length(runs: Sequence[ReferenceRun], observed: ObservedRuns) -> float:
    return float(np.mean([run.length_m / correct_volume(run, observed) for run in runs]))


def _test_contradiction(estimate: LinearEstimate) -> float:
    if not estimate.redundancy:
        return math.nan
    from scipy.special import chdtrc

    return float(chdtrc(estimate.redundancy, estimate.chi_square))


CLASSES: tuple[tuple[float, float], ...] = ((0.2, 0.2), (0.5, 0.5), (1.0, 1.0), (2.0, 2.0))
"""Accuracy class and its largest permissible error in service, percent of the load (OIML R 50-1:2014, table 1)."""


def find_class(error: Result) -> float | None:
    """Return the best accuracy class whose limits in service error and expanded uncertainty keep; None: none."""
    reach = 100 * (abs(error.value) + error.budget.expanded)
    return next((name for name, limit in CLASSES if reach <= limit), None)


def predict_run_sigma(test: MaterialTest, result: Result) -> float:
    """Return the relative σ of one later run that a result corrects: the result's own, and one run's scatter."""
    scatter = max((one.sigma_run for one in test.by_kind.values() if one.degrees_of_freedom), default=0.0)
    return math.hypot(result.budget.sigma / result.value, scatter)
