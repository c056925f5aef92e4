"""The baseline of the auxiliaries: precision against the visibility of the load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.plan.footprint import area_mm2, clip_to_strip, overlap_shares, project_footprint
from beltscape.plan.occlusion import visible_shares
from beltscape.plan.planned_rig import PlannedRig, make_planned_rig
from beltscape.plan.precision import predict_sigma_mm
from beltscape.plan.settings import PlanSettings

_SHARES = (0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.8)
"""Baselines over the depth, the tangents of tilts of 6° to 39°; the requested limits choose among them."""
_STEP_MM = 5.0
"""Baselines are multiples of this, since a frame is not built more precisely."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """A baseline and its consequences."""

    baseline_mm: float
    tilt_deg: float
    sigma_mm: float
    """σ of the height at the point where all axes meet, seen by all cameras."""
    seen: tuple[float, ...]
    """Probability that at least 0, 1, …, n auxiliaries see a spot between lumps that the core sees; worst spot."""
    covered: tuple[float, ...]
    """Share of the strip at the edges that lies in at least 0, 1, …, n auxiliary images; smallest of the planes."""
    refused: str
    """Reason why the baseline is not acceptable; empty if it is."""


def list_alternatives(settings: PlanSettings, height_mm: float) -> tuple[Alternative, ...]:
    """Return baselines from short to long, in even steps of the tilt's tangent, with the requested one if given."""
    rig = settings.rig
    depth = height_mm - sum(settings.belt.material_mm) / 2
    baselines = {round(depth * share / _STEP_MM) * _STEP_MM for share in _SHARES}
    if rig.baseline_mm is not None:
        baselines.add(rig.baseline_mm)
    assessed = [
        assess_baseline(settings, height_mm, baseline) for baseline in sorted(baselines) if baseline > 0
    ]
    return tuple(candidate for candidate in assessed if candidate is not None)


def assess_baseline(settings: PlanSettings, height_mm: float, baseline_mm: float) -> Alternative | None:
    """Assess one baseline; None where a camera would see past the belt to the horizon."""
    planned = make_planned_rig(settings, height_mm, baseline_mm)
    try:
        covered = _covered_shares(settings, planned)
    except InputError:
        return None
    seen = _visible_shares(settings, planned)
    sigma = float(predict_sigma_mm(planned, planned.target_mm[None], settings.precision.sigma_px)[0])
    tilt = float(np.rad2deg(planned.tilt_rad))
    return Alternative(
        baseline_mm, tilt, sigma, seen, covered, _describe_refusal(settings, baseline_mm, tilt, seen, covered)
    )


def choose_baseline(settings: PlanSettings, candidates: Sequence[Alternative]) -> Alternative:
    """Return the requested baseline, or the most precise of the acceptable ones.

    Where none is acceptable, the one that the auxiliaries see best is returned.
    """
    requested = settings.rig.baseline_mm
    if requested is not None:
        matching = [candidate for candidate in candidates if candidate.baseline_mm == requested]
        if not matching:
            raise InputError(
                f"baseline_mm = {requested:g}: auxiliaries would see past the belt to the horizon; give a shorter one"
            )
        return matching[0]
    number = settings.rig.required_views
    acceptable = [candidate for candidate in candidates if not candidate.refused]
    if acceptable:
        return min(acceptable, key=lambda candidate: candidate.sigma_mm)
    return max(
        candidates,
        key=lambda candidate: (
            min(candidate.seen[number], candidate.covered[number]),
            -candidate.baseline_mm,
        ),
    )


def _describe_refusal(
    settings: PlanSettings, baseline: float, tilt: float, seen: Sequence[float], covered: Sequence[float]
) -> str:
    rig, number = settings.rig, settings.rig.required_views
    widest = rig.max_baseline_mm or settings.belt.span_mm / 2
    if baseline > widest:
        return f"wider than {widest:g} mm"
    if tilt > rig.max_angle_deg:
        return f"views differ by more than {rig.max_angle_deg:g}°"
    if seen[number] < rig.required_share:
        return f"lumps hide more than {1 - rig.required_share:.0%}"
    if covered[number] < rig.required_share:
        return "too little in the auxiliaries' images"
    return ""


def _visible_shares(settings: PlanSettings, planned: PlannedRig) -> tuple[float, ...]:
    """Return the smallest shares over the middle and the edges of the load."""
    middle, half = planned.target_mm[2], settings.belt.span_mm / 2
    worst: tuple[float, ...] | None = None
    for x in (0.0, half, -half):
        spot = np.array([x, 0.0, middle])
        directions: list[NDArray[np.float64]] = []
        for name in planned.rig.cameras:
            to_camera = planned.position_mm(name) - spot
            directions.append(to_camera[:2] / to_camera[2])
        shares = visible_shares(directions[0], np.array(directions[1:]), settings.belt.lump_cover)
        worst = shares if worst is None else tuple(map(min, worst, shares))
    assert worst is not None
    return worst


def _covered_shares(settings: PlanSettings, planned: PlannedRig) -> tuple[float, ...]:
    """Return the smallest shares over the planes, of the strip that the core sees."""
    rig = planned.rig
    shares: list[tuple[float, ...]] = []
    for height, width in settings.belt.planes:
        base = clip_to_strip(width, project_footprint(planned, rig.core, height))
        if area_mm2(base) > 0:
            shares.append(
                overlap_shares(base, [project_footprint(planned, name, height) for name in rig.auxiliaries])
            )
    return tuple(map(min, zip(*shares, strict=True)))
