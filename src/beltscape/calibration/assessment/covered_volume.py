"""Limit of a rig to the volume that the board covered, where the belt is not known.

Where the board never was, lenses are extrapolated. If the belt lies there, other views are needed; if not, the rig is
good. So a rig without a given belt is limited as lenses are that corners determine in a part of their image only: by
the distance from the principal point up to which each camera is used (`valid_radius_px` of rig.json).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from beltscape.calibration.assessment.coverage import (
    CameraCoverage,
    Coverage,
    UncoveredVolumeError,
    assess_coverage,
    compute_general_covariance,
    describe_gap,
    has_lost_volume,
)
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.core.arrays import Mask
from beltscape.core.geometry.rig import Rig

MAX_GAP = 0.02
"""Largest share of the needed pixels within a camera's limit that the board never reached and whose depth is
unusable: that of a given volume."""
MIN_COVERED = 0.05
"""Least share of the core's view that must remain; a rig for less measures nothing that is of use."""


@dataclass(frozen=True, slots=True, eq=False)
class CoveredRig:
    """A rig limited to the volume that the board covered."""

    rig: Rig
    coverage: Coverage
    """Within the limits."""
    limits_px: Mapping[str, float]
    """By camera: distance from the principal point up to which it is used; only those that the coverage limits."""
    share: float
    """Share of the core's view that remains: seen by the core and another camera within their limits."""

    def describe(self) -> str:
        """Return the limits in one line."""
        limits = ", ".join(f"{name} {radius:.0f} px" for name, radius in self.limits_px.items())
        return (
            f"the rig is limited to the {self.share:.0%} of the view of {self.rig.core} that the board covered. "
            f"Nothing is measured farther from the principal points than {limits}; name the belt with --belt to "
            "learn whether that suffices"
        )


def limit_to_coverage(
    adjustment: BundleAdjustmentResult, limited: Rig, inflation: float, coverage: Coverage
) -> CoveredRig:
    """Return the rig limited to what the board covered.

    Raises
    ------
    UncoveredVolumeError
        When hardly anything remains, or depth stays uncertain within the limits.
    """
    general = compute_general_covariance(adjustment)
    limits: dict[str, float] = {}
    rig, again = limited, coverage
    for _ in limited.cameras:
        name, radius = _find_worst(again, limits)
        if name is None:
            break
        limits[name] = radius
        camera = replace(rig.cameras[name], valid_radius_px=round(max(radius, 1.0), 2))
        rig = replace(rig, cameras={**rig.cameras, name: camera})
        again = assess_coverage(adjustment, rig, inflation, coverage.volume, general)
    share = again.share(_mask_measured(again))
    if has_lost_volume(again) or share < MIN_COVERED:
        raise UncoveredVolumeError(
            f"{describe_gap(coverage, coverage.is_unusable)}, or name the belt with --belt", coverage
        )
    return CoveredRig(rig, again, limits, share)


def _find_worst(coverage: Coverage, limits: Mapping[str, float]) -> tuple[str | None, float]:
    """Return the camera without a limit that has the largest gap, and its limit; None without a gap."""
    gaps = {
        name: coverage.is_unusable & own.is_seen & ~own.is_reached
        for name, own in coverage.cameras.items()
        if name not in limits
    }
    worst = max(gaps, key=lambda name: int(gaps[name].sum()), default=None)
    if worst is None or coverage.share(gaps[worst]) <= MAX_GAP:
        return None, np.inf
    return worst, _find_limit_px(coverage.cameras[worst], gaps[worst])


def _find_limit_px(own: CameraCoverage, gap: Mask) -> float:
    """Return the largest distance from the principal point within which the board left hardly a gap."""
    seen = own.is_seen
    distance = np.linalg.norm(own.pixels[seen] - own.camera.center_px, axis=1)
    order = np.argsort(distance, kind="stable")
    share = np.cumsum(gap[seen][order]) / np.arange(1, len(order) + 1)
    inside = np.flatnonzero(share <= MAX_GAP)
    return float(distance[order][inside[-1]]) if inside.size else 0.0


def _mask_measured(coverage: Coverage) -> Mask:
    """Return which points (N,) the core and another camera see within their limits."""
    sees = np.stack([own.is_seen for own in coverage.cameras.values()])
    return np.asarray(sees[0] & (sees.sum(axis=0) >= 2))
