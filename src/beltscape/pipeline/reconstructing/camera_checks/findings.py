"""The findings about the cameras of a sequence, frame by frame; faults hold until a check passes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltscape.core.geometry.rig import Rig
from beltscape.core.live.findings import Finding
from beltscape.health.cameras.poses import (
    PoseFault,
    make_pose_findings,
    make_unchecked_finding,
    make_unreliable_finding,
    repeat_faults,
)
from beltscape.health.cameras.redundancy import make_redundancy_finding
from beltscape.stereo.consistency.diagnosis.fault_texts import CameraFault
from beltscape.stereo.consistency.rig_consistency import RigConsistency

_LONGEST_UNCONFIRMED = 10
"""Number of checks without a consistent auxiliary after which the cameras count as unchecked again."""


class CameraFindings:
    """Makes the findings of each frame from the last check."""

    def __init__(self, rig: Rig, auxiliaries: tuple[str, ...]) -> None:
        self.latest: tuple[Finding, ...] = ()
        """The findings of the last frame."""
        self._rig, self._auxiliaries = rig, auxiliaries
        self._consistency: RigConsistency | None = None
        self._checked: tuple[Finding, ...] = ()
        """The findings about poses of the last check."""
        self._unconfirmed = _LONGEST_UNCONFIRMED
        """Checks since the last that showed an auxiliary to be consistent."""

    def set_checked(
        self,
        consistency: RigConsistency,
        faults: Sequence[CameraFault],
        used: tuple[str, ...],
        systematic_mm: float,
        *,
        used_before: tuple[str, ...],
        is_suspect: bool,
    ) -> None:
        """Set the findings of a checked frame, measured with the ``used`` auxiliaries.

        ``systematic_mm`` is the error of its depth. The frames since the last check were measured with
        ``used_before``: in them an auxiliary that is now excluded had its share of the error.
        """
        share = {
            each.camera: each.depth_error_mm / len(self._auxiliaries)
            for each in consistency.cameras
            if each.camera in used_before
        }
        pose_faults = [
            PoseFault(
                fault,
                "degraded",
                float(np.nanmax([systematic_mm, *(share.get(name, 0.0) for name in fault.cameras)])),
            )
            for fault in faults
        ]
        self._consistency = consistency
        self._unconfirmed = 0 if consistency.find_auxiliaries("sound") else self._unconfirmed + 1
        self._checked = make_pose_findings(consistency, self._rig, pose_faults, is_suspect=is_suspect)
        self._complete(self._checked, used)

    def set_refused(self, consistency: RigConsistency, faults: Sequence[CameraFault]) -> None:
        """Set the findings of a frame whose depth is refused because of its cameras."""
        lost = [PoseFault(fault, "missing", 0.0) for fault in faults]
        self._checked = make_pose_findings(consistency, self._rig, lost)
        self.latest = self._checked

    def set_unreliable(self, cause: str) -> None:
        """Add that the last frame's depth is unreliable."""
        self.latest = (*self.latest, make_unreliable_finding(cause))

    def set_unmatched(self) -> None:
        """Set the findings of a frame without depth that was not checked."""
        self.latest = repeat_faults(self._checked)

    def set_unchecked(self, used: tuple[str, ...]) -> None:
        """Set the findings of a frame that was not checked."""
        self._complete(repeat_faults(self._checked), used)

    def _complete(self, poses: Sequence[Finding], used: tuple[str, ...]) -> None:
        """Add the redundancy; before the cameras were confirmed, no frame is valid."""
        is_open = self._unconfirmed >= _LONGEST_UNCONFIRMED and not any(each.is_fault for each in poses)
        self.latest = (
            *poses,
            make_unchecked_finding(self._unconfirmed, _LONGEST_UNCONFIRMED, is_open=is_open),
            make_redundancy_finding(self._auxiliaries, used, self._consistency),
        )
