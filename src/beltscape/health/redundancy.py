"""Finding about the redundancy of a frame: the number of auxiliaries that contribute to its depth."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from beltscape.core.alarm_catalogue import CAMERA_REDUNDANCY
from beltscape.core.findings import Finding
from beltscape.core.translatable_message import make_message
from beltscape.stereo.consistency.rig_consistency import RigConsistency

_LEAST_AGREEMENT = 0.4
"""Share of the best auxiliary's agreement below which one hardly contributes; sound captures have at least 0.7."""


def make_redundancy_finding(
    auxiliaries: Sequence[str], used: Collection[str], consistency: RigConsistency | None
) -> Finding:
    """Return the number of auxiliaries that contribute; fewer than the rig has degrade the frame.

    ``used`` are those that were matched; ``consistency`` is that of the last check, None before it. The smaller
    redundancy raises σ of each pixel already, so the finding adds none.
    """
    weak = [] if consistency is None else _find_weak(consistency, used)
    absent = [name for name in auxiliaries if name not in used]
    count = len(auxiliaries) - len(absent) - len(weak)
    if count == len(auxiliaries):
        return Finding(CAMERA_REDUNDANCY, count, 0.0, len(auxiliaries), "cameras")
    without = ", ".join((*absent, *weak))
    text = make_message("camera_redundancy", count=count, all=len(auxiliaries), without=without)
    return Finding(CAMERA_REDUNDANCY, count, 0.0, len(auxiliaries), "cameras", "", text, "degraded")


def _find_weak(consistency: RigConsistency, used: Collection[str]) -> list[str]:
    """Return the used auxiliaries in which far fewer points are found than in the best one."""
    best = max((each.agreement for each in consistency.cameras if np.isfinite(each.agreement)), default=0.0)
    return [
        each.camera
        for each in consistency.cameras
        if each.camera in used and each.agreement < _LEAST_AGREEMENT * best
    ]
