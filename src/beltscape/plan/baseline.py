"""The baseline of the auxiliaries: precision against the visibility of the load.

Lumps occlude: auxiliaries see a spot between lumps that the core sees only with a probability. The load is a
Boolean model: balls of equal size lie on a plane, their contact points a Poisson process, covering a given share of
it seen from above. A spot is seen along a direction when no ball occludes it. With λ the number of balls per area
and U the set of contact points whose balls would occlude any of several directions, all of them see it with
probability exp(−λ|U|). Only directions and cover matter, not the size of the balls.

References
----------
Chiu, Stoyan, Kendall & Mecke, Stochastic Geometry and its Applications, 3rd ed. 2013, doi:10.1002/9781118658222.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.plan.coverage import area_mm2, clip_to_strip, overlap_shares, project_footprint
from beltscape.plan.planned_rig import PlannedRig, make_planned_rig, predict_sigma_mm
from beltscape.plan.settings import PlanSettings

_CELLS = 240
"""Cells per side of the raster of contact points: areas are accurate to about 0.2 %."""


def visible_shares(core: NDArray[np.float64], others: NDArray[np.float64], cover: float) -> tuple[float, ...]:
    """Return the probability that at least 0, 1, …, n of the other directions see a spot that the core sees.

    Parameters
    ----------
    core
        (2,) tangent of the direction to the core camera: horizontal over vertical, along x and y.
    others
        (n, 2) of the auxiliaries; n is at most 8.
    cover
        Share of the plane covered by balls, seen from above.
    """
    code, cell_area = _mark_occluders(np.vstack([core, others]))
    count = len(others)
    areas = np.bincount(code.ravel(), minlength=2 ** (count + 1)) * cell_area
    density = -np.log(1 - cover) / np.pi  # balls of radius 1
    codes = np.arange(len(areas))
    exactly = np.zeros(count + 1)
    # probability that the core and all of a set see it; then inclusion–exclusion
    all_of_set = {s: np.exp(-density * areas[(codes & (2 * s + 1)) != 0].sum()) for s in range(2**count)}
    for s in all_of_set:
        rest = (2**count - 1) ^ s
        exactly[s.bit_count()] += sum(
            (-1) ** extra.bit_count() * all_of_set[s | extra] for extra in all_of_set if extra & rest == extra
        )
    at_least = np.cumsum(exactly[::-1])[::-1] / all_of_set[0]
    return tuple(float(share) for share in np.clip(at_least, 0, 1))


def _mark_occluders(tangents: NDArray[np.float64]) -> tuple[NDArray[np.int64], float]:
    """Return cells whose bit i is set if a unit ball there occludes the origin from direction i, and their area."""
    reach = float(2 + 2 * np.abs(tangents).max())
    steps = (np.arange(_CELLS) + 0.5) / _CELLS * 2 * reach - reach
    x, y = np.meshgrid(steps, steps)
    centers = np.stack([x, y, np.ones_like(x)], axis=-1)  # centres lie one radius up
    square = x**2 + y**2 + 1
    code = np.zeros(x.shape, np.int64)
    for i, tangent in enumerate(tangents):
        ray = np.array([*tangent, 1.0]) / np.sqrt(1 + tangent @ tangent)
        distance2 = square - (centers @ ray) ** 2
        code |= (distance2 < 1).astype(np.int64) << i
    return code, (2 * reach / _CELLS) ** 2


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
    seen = _compute_visible_shares(settings, planned)
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


def _compute_visible_shares(settings: PlanSettings, planned: PlannedRig) -> tuple[float, ...]:
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
