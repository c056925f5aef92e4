"""The JSON document of a comparison: figures with their units in the keys; null: not known."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from beltscape.reprocessing.comparison.comparison import Comparison, PairedTotal, Provenance, WholeLedger
from beltscape.reprocessing.comparison.differences import (
    BeltPart,
    DifferencePattern,
    DifferingStretch,
    StretchSide,
)
from beltscape.reprocessing.comparison.ledger import ComparedLedger
from beltscape.reprocessing.comparison.texts import explain_causes, explain_sigma, list_warnings, make_verdict
from beltscape.reprocessing.comparison.uncertainty import Intervals

FORMAT = "beltscape-comparison/1"


def make_document(comparison: Comparison) -> dict[str, Any]:
    """Return the document."""
    alignment, sides = comparison.alignment, (comparison.first, comparison.second)
    return {
        "format": FORMAT,
        "verdict": make_verdict(comparison),
        "identical": comparison.is_identical,
        "agrees": comparison.volume.agrees,
        "differing_values": dict(comparison.differing),
        "a": _describe_whole(sides[0], comparison.wholes[0]),
        "b": _describe_whole(sides[1], comparison.wholes[1]),
        "alignment": {
            "shared_frames": alignment.shared_frames,
            "offset_mm": alignment.offset_mm,
            "spread_mm": alignment.spread_mm,
        },
        "compared_m": comparison.compared_mm / 1000,
        "same_rig_m": comparison.same_rig_mm / 1000,
        "volume_m3": _describe_total(comparison.volume, 1e-9),
        "mass_kg": None if comparison.mass is None else _describe_total(comparison.mass, 1.0),
        "without_density_m": [mm / 1000 for mm in comparison.without_density_mm],
        "sigma": explain_sigma(comparison),
        "provenance": [_describe_provenance(one) for one in comparison.provenance],
        "pattern": None if comparison.pattern is None else _describe_pattern(comparison.pattern),
        "causes": list(explain_causes(comparison)),
        "changed_standings": [_describe_part(part) for part in comparison.changes],
        "largest_differences": [_describe_stretch(one) for one in comparison.stretches],
        "intervals": _describe_intervals(comparison.intervals),
        "limits": list(list_warnings(comparison)),
    }


def _describe_whole(ledger: ComparedLedger, whole: WholeLedger) -> dict[str, Any]:
    return {
        "folder": ledger.folder,
        "records": whole.records,
        "belt_m": whole.length_mm / 1000,
        "not_measured_m": whole.missing_mm / 1000,
        "volume_m3": whole.volume_mm3 * 1e-9,
        "alone_m": whole.alone_mm / 1000,
        "alone_m3": whole.alone_mm3 * 1e-9,
    }


def _describe_total(total: PairedTotal, factor: float) -> dict[str, Any]:
    values = {name: value * factor for name, value in asdict(total).items()}
    return {**values, "relative": total.relative, "agrees": total.agrees}


def _describe_provenance(one: Provenance) -> dict[str, Any]:
    pairs = [{"a": a, "b": b, "m": mm / 1000} for (a, b), mm in one.pairs.items()]
    return {
        "part": one.part,
        "differs": one.differing_mm > 0,
        "differing_m": one.differing_mm / 1000,
        "values": pairs,
    }


def _describe_pattern(pattern: DifferencePattern) -> dict[str, Any]:
    unit = "relative" if pattern.kind == "proportional" else "mm2"
    return {"kind": pattern.kind, unit: pattern.value, f"sigma_{unit}": pattern.sigma}


def _describe_part(part: BeltPart) -> dict[str, Any]:
    return {
        "a": part.first,
        "b": part.second,
        "m": part.length_mm / 1000,
        "stretches": part.stretches,
        "volume_m3": part.volume_mm3 * 1e-9,
        "longest_mm": part.longest_mm,
        "reasons": [{"a": pair.first, "b": pair.second, "m": pair.length_mm / 1000} for pair in part.reasons],
        "more_reasons": part.more_reasons,
    }


def _describe_stretch(one: DifferingStretch) -> dict[str, Any]:
    sigma = one.sigma_mm3
    return {
        "belt_mm": [one.from_mm, one.to_mm],
        "time_ns": one.time_ns,
        "difference_m3": one.difference_mm3 * 1e-9,
        "difference_sigma_m3": sigma * 1e-9,
        "sigmas": abs(one.difference_mm3) / sigma if sigma > 0 else math.nan,
        "a": _describe_side(one.first),
        "b": _describe_side(one.second),
    }


def _describe_side(side: StretchSide) -> dict[str, Any]:
    return {
        "belt_mm": [side.from_mm, side.to_mm],
        "records": side.records,
        "frames": [side.first_frame, side.last_frame],
        "standings": side.standings,
        "reasons": side.reasons,
        "volume_m3": side.volume_mm3 * 1e-9,
        "sigma_m3": side.sigma_mm3 * 1e-9,
    }


def _describe_intervals(intervals: Intervals) -> dict[str, Any]:
    volume = intervals.volume
    unit = "ns" if intervals.axis == "time" else "mm"
    return {
        "axis": intervals.axis,
        f"start_{unit}": intervals.start,
        f"width_{unit}": intervals.width,
        "belt_m": volume.length_mm / 1000,
        "seconds": intervals.seconds,
        "a_m3": volume.value[0] * 1e-9,
        "b_m3": volume.value[1] * 1e-9,
        "difference_m3": volume.difference * 1e-9,
        "difference_sigma_m3": volume.difference_sigma * 1e-9,
        "a_m3_h": intervals.flow_m3_h[0],
        "b_m3_h": intervals.flow_m3_h[1],
        "difference_m3_h": intervals.difference_m3_h,
        "difference_sigma_m3_h": intervals.difference_sigma_m3_h,
        "agrees": volume.agrees,
    }
