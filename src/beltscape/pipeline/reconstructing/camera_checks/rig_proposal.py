"""The rig with the estimated pose of a camera that moved: a proposal for a person to accept, never used by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from beltscape.core.errors import OutputError
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.files.rig_json import write_rig
from beltscape.stereo.consistency.faults.pose_change import PoseChange
from beltscape.stereo.consistency.rig_consistency import RigConsistency

PROPOSAL_FILE = "rig.proposed.json"
_POSE = ("turn_x_rad", "turn_y_rad", "turn_z_rad", "shift_x_mm", "shift_y_mm", "shift_z_mm")
"""Parameters of a pose in rig.json's covariance."""
_MORE_PRECISE = 0.8
"""A later estimate replaces a proposal if its σ is below this share of the proposal's."""
_MOVED_AGAIN = 4.0
"""It also does if it differs by this number of its σ."""


def make_rig_writer(folder: Path, rig: Rig, reporter: Reporter) -> Callable[[Rig], None]:
    """Return a function that writes a proposed pose of the ``rig``'s cameras to the folder's rig.proposed.json.

    The intrinsics stay those of ``rig``, also if the proposal comes from images of another size.
    """

    def write(proposed: Rig) -> None:
        path = folder / PROPOSAL_FILE
        try:
            write_rig(
                path, replace(rig, cam_from_core=proposed.cam_from_core, covariance=proposed.covariance)
            )
        except OutputError as error:
            reporter.warn(f"{path}: the proposed rig could not be written: {error}")

    return write


class RigProposals:
    """Passes on the best estimate of a moved camera's pose."""

    def __init__(self, rig: Rig, propose: Callable[[Rig], None] | None) -> None:
        self._rig, self._propose = rig, propose
        self._last: PoseChange | None = None

    def add(self, consistency: RigConsistency) -> None:
        """Propose the rig of a frame's pose change if it is new or more precise than the proposal before."""
        change = consistency.pose_change
        if change is None or self._propose is None or not (change.is_plausible and self._is_better(change)):
            return
        self._last = change
        self._propose(make_proposed_rig(self._rig, change))

    def _is_better(self, change: PoseChange) -> bool:
        last = self._last
        if last is None or last.camera != change.camera:
            return True
        sigma = np.sqrt(np.diag(change.covariance) + np.diag(last.covariance))
        has_moved = bool((np.abs(change.change - last.change) > _MOVED_AGAIN * sigma).any())
        return has_moved or change.shift_sigma_mm < _MORE_PRECISE * last.shift_sigma_mm


def make_proposed_rig(rig: Rig, change: PoseChange) -> Rig:
    """Return the rig after the movement, with the covariance of the moved pose.

    A movement of the core is one of all auxiliaries against it; their covariances stay those of the rig.
    """
    names = [f"{change.camera}.{parameter}" for parameter in _POSE]
    known = [str(name) for name in rig.covariance.get("parameters", [])]
    if change.camera == rig.core:
        return replace(rig, cam_from_core=change.rig.cam_from_core)
    parameters = [*(name for name in known if name not in names), *names]
    matrix = np.zeros((len(parameters), len(parameters)))
    kept = [known.index(name) for name in parameters if name in known and name not in names]
    if kept:
        matrix[: len(kept), : len(kept)] = np.asarray(rig.covariance["matrix"], np.float64)[
            np.ix_(kept, kept)
        ]
    matrix[len(kept) :, len(kept) :] = change.covariance
    covariance = {**rig.covariance, "parameters": parameters, "matrix": matrix.tolist()}
    return replace(rig, cam_from_core=change.rig.cam_from_core, covariance=covariance)
