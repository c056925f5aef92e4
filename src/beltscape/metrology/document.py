"""A material test as a document of plain values: what the certificate shows, signs and keeps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from beltscape.metrology.material_test import (
    SIGNIFICANCE,
    LoadResult,
    MaterialTest,
    Result,
    find_class,
    predict_run_sigma,
)
from beltscape.metrology.observations import (
    REFERENCE_KINDS,
    ObservedRuns,
    ReferenceKind,
    ReferenceRun,
    correct_volume,
)
from beltscape.metrology.repeatability import FTest, Repeatability
from beltscape.metrology.settings import MaterialTestSettings
from beltscape.metrology.uncertainty import Budget

FORMAT = "beltscape-material-test/1"
UNITS: Mapping[str, str] = {
    "mass_factor": "kg/m³",
    "span_factor": "",
    "bulk_density": "kg/m³",
    "dry_density": "kg/m³",
    "moisture": "%",
    "volume_error": "%",
    "mass_error": "%",
}
"""By result; those in percent are shares times 100."""
_LARGE_CORRECTION = 0.02
"""Share of the load that the zero may take without a remark; a belt scale's zero is set below it. Chosen."""


def make_test_document(
    test: MaterialTest, settings: MaterialTestSettings, sources: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Return the document; ``sources`` say of each run where and how well it was measured."""
    observed = test.observations
    errors = [one for one in (test.volume_error, test.mass_error) if one is not None]
    return {
        "format": FORMAT,
        "name": settings.name,
        "operator": settings.operator,
        "place": settings.place,
        "product": settings.product,
        "remark": settings.remark,
        "confidence": observed.confidence,
        "references": _describe_references(test),
        "samples": _describe_samples(test),
        "zero": _describe_zero(test),
        "runs": [
            {**_describe_run(run, observed), **source}
            for run, source in zip(observed.runs, sources, strict=True)
        ],
        "repeatability": {kind: _describe_repeatability(own) for kind, own in test.by_kind.items()},
        "loads": [_describe_load(one) for one in test.loads],
        "results": [describe_result(one) for one in test.results],
        "undetermined": list(test.undetermined),
        "errors": [{**describe_result(one), "class": find_class(one)} for one in errors],
        "later_run_sigma_percent": {one.key: 100 * predict_run_sigma(test, one) for one in test.results[:1]},
        "contradiction": test.contradiction,
        "notes": list_notes(test),
    }


def _describe_references(test: MaterialTest) -> dict[str, Any]:
    return {
        kind: {
            "name": one.name,
            "certificate": one.certificate,
            "sigma_percent": 100 * one.sigma_share,
            "sigma_constant": one.sigma_constant,
            "resolution": one.resolution,
            "degrees_of_freedom": one.degrees_of_freedom,
        }
        for kind, one in test.observations.references.items()
        if kind in test.by_kind
    }


def _describe_run(run: ReferenceRun, observed: ObservedRuns) -> dict[str, Any]:
    return {
        "load": run.load,
        "kind": run.kind,
        "reference": run.reference,
        "measured_m3": run.volume_m3,
        "corrected_m3": correct_volume(run, observed),
        "length_m": run.length_m,
        "level_m3_h": run.level,
        "recorded_kg": run.recorded_kg,
        "label": run.label,
    }


def _describe_load(one: LoadResult) -> dict[str, Any]:
    return {
        "load": one.name,
        "kind": one.kind,
        "runs": one.runs,
        "level_m3_h": one.level,
        "deviation_percent": 100 * one.deviation,
        "deviation_sigma_percent": 100 * one.deviation_sigma,
        "sigma_run_percent": 100 * one.sigma_run,
    }


def _describe_samples(test: MaterialTest) -> dict[str, Any]:
    scale = {"moisture": 100.0}
    return {
        name: {
            "value": scale.get(name, 1.0) * one.value,
            "sigma": scale.get(name, 1.0) * one.sigma,
            "degrees_of_freedom": one.degrees_of_freedom,
        }
        for name, one in (test.observations.samples or {}).items()
    }


def _describe_zero(test: MaterialTest) -> dict[str, Any] | None:
    zero = test.observations.zero
    if zero is None:
        return None
    return {
        "area_mm2": zero.area_mm2,
        "sigma_mm2": zero.sigma_mm2,
        "revolutions": zero.revolutions,
        "degrees_of_freedom": zero.degrees_of_freedom,
        "scatter_mm2": zero.scatter_mm2,
        "share_percent": {kind: 100 * share for kind, share in test.zero_share.items()},
    }


def _describe_repeatability(own: Repeatability) -> dict[str, Any]:
    line = own.line
    return {
        "sigma_run_percent": 100 * own.sigma_run,
        "degrees_of_freedom": own.degrees_of_freedom,
        "linearity": _describe_test(own.linearity),
        "slope_percent_per_100_m3_h": None if line is None else -1e4 * line.slope,
        "slope_sigma_percent_per_100_m3_h": None if line is None else 1e4 * line.slope_sigma,
        "lack_of_fit": None if line is None else _describe_test(line.lack_of_fit),
    }


def _describe_test(test: FTest | None) -> dict[str, Any] | None:
    if test is None:
        return None
    return {
        "f": test.ratio,
        "degrees_of_freedom": [test.degrees_between, test.degrees_within],
        "probability": test.probability,
        "is_significant": test.is_significant(SIGNIFICANCE),
    }


def describe_result(result: Result) -> dict[str, Any]:
    """Return a result in its unit with its budget."""
    factor = 100.0 if UNITS[result.key] == "%" else 1.0
    return {
        "key": result.key,
        "unit": UNITS[result.key],
        "value": factor * result.value,
        **describe_budget(result.budget, factor),
    }


def describe_budget(budget: Budget, factor: float = 1.0) -> dict[str, Any]:
    """Return a budget; an infinite number of degrees of freedom is null."""
    return {
        "sigma": factor * budget.sigma,
        "sigma_a": factor * budget.select_sigma("A"),
        "sigma_b": factor * budget.select_sigma("B"),
        "degrees_of_freedom": budget.degrees_of_freedom,
        "coverage_factor": budget.coverage_factor,
        "expanded": factor * budget.expanded,
        "budget": [
            {
                "key": one.key,
                "type": one.kind,
                "sigma": factor * one.sigma,
                "degrees_of_freedom": one.degrees_of_freedom,
                "variance_share": (one.sigma / budget.sigma) ** 2,
            }
            for one in budget.contributions
        ],
    }


def list_notes(test: MaterialTest) -> list[str]:
    """Return the keys of what a reader must know: of texts of the certificate."""
    bent = any(
        one.linearity is not None and one.linearity.is_significant(SIGNIFICANCE)
        for one in test.by_kind.values()
    )
    loads = {run.load for run in test.observations.runs}
    apart = test.find("span_factor") is not None
    checks = {
        "not_apart": not apart and test.find("mass_factor") is not None,
        "no_zero": test.observations.zero is None,
        "large_zero": any(abs(share) > _LARGE_CORRECTION for share in test.zero_share.values()),
        "one_load": len(loads) == 1,
        "nonlinear": bent,
        "contradiction": test.contradiction < SIGNIFICANCE,
        "few_runs": any(_count_least(test, kind) < 3 for kind in REFERENCE_KINDS if kind in test.by_kind),
    }
    return [key for key, holds in checks.items() if holds]


def _count_least(test: MaterialTest, kind: ReferenceKind) -> int:
    return min(one.runs for one in test.by_kind[kind].loads)


def recommend_density(document: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return density and σ, kg/m³, by which volumes as they are measured give true masses; None without masses."""
    found = next((one for one in document["results"] if one["key"] == "mass_factor"), None)
    if found is None or not math.isfinite(found["value"]):
        return None
    return found["value"], found["sigma"]
