"""Do the cameras' frames of one name belong to one instant? Told from the poses that each camera sees alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from beltscape.calibrate.intrinsics.zhang import MonocularCalibration
from beltscape.core.pose import Pose

SHIFTS = range(-3, 4)
MIN_FRAMES = 5
CLEAR_IMPROVEMENT = 0.2
"""A shift counts when it leaves less than this share of the scatter."""
MAX_SCATTER = 0.05
"""Relative poses that scatter by more than this share of the distance do not belong together."""


@dataclass(frozen=True, slots=True)
class FrameMisfit:
    """A camera whose frames do not belong to the others'."""

    camera: str
    shift: int | None
    """The others' frame number k is its number k + shift; None: no shift mends it."""
    others: tuple[str, ...]
    """The cameras that it does not fit."""

    def describe(self) -> str:
        """In words, with the mend."""
        against = ", ".join(self.others)
        if self.shift is None:
            return (
                f"camera {self.camera}: its frames do not belong to those of {against} of the same name; "
                "check its trigger or the names of its images"
            )
        way = "low" if self.shift < 0 else "high"
        return (
            f"camera {self.camera}: its frame numbers are {abs(self.shift)} too {way} against {against}; "
            "rename its images"
        )


def find_frame_misfits(
    cameras: Mapping[str, MonocularCalibration], frames: Sequence[str]
) -> tuple[FrameMisfit, ...]:
    """Cameras whose frames are shifted against the majority's, or torn from them.

    Two cameras stand still about each other, so the pose between them is the same in every frame; where it
    scatters, their frames of one name are not of one instant.
    """
    fits = {
        (a, b): fit
        for a, b in combinations(cameras, 2)
        if (fit := _fit_shift(cameras[a], cameras[b], frames)) is not None
    }
    together = _find_largest_consistent(list(cameras), fits)
    return tuple(
        FrameMisfit(name, _find_shift(name, together, fits), tuple(together))
        for name in cameras
        if name not in together and _is_mostly_inconsistent(name, together, fits)
    )


@dataclass(frozen=True, slots=True)
class _ShiftFit:
    shift: int
    """Frames by which the second camera's names are to be moved to fit the first's."""
    is_consistent: bool
    """Whether the poses agree after the shift."""

    @property
    def is_synchronous(self) -> bool:
        return self.is_consistent and self.shift == 0


def _find_largest_consistent(names: Sequence[str], fits: Mapping[tuple[str, str], _ShiftFit]) -> list[str]:
    """The largest set of cameras of which no two disagree, grown from each camera in turn; of equals the first."""
    groups = []
    for first_name in names:
        group = [first_name]
        for name in names:
            if name != first_name and all(_is_synchronous(name, other, fits) is not False for other in group):
                group.append(name)
        groups.append([name for name in names if name in group])
    return max(groups, key=len, default=[])


def _is_mostly_inconsistent(
    name: str, others: Sequence[str], fits: Mapping[tuple[str, str], _ShiftFit]
) -> bool:
    known = [good for other in others if (good := _is_synchronous(name, other, fits)) is not None]
    return 2 * known.count(False) > len(known)


def _is_synchronous(a: str, b: str, fits: Mapping[tuple[str, str], _ShiftFit]) -> bool | None:
    """Whether two cameras agree; None where too few frames tell."""
    fit = fits.get((a, b)) or fits.get((b, a))
    return None if fit is None else fit.is_synchronous


def _find_shift(name: str, others: Sequence[str], fits: Mapping[tuple[str, str], _ShiftFit]) -> int | None:
    shifts = [
        fit.shift if b == name else -fit.shift
        for (a, b), fit in fits.items()
        if fit.is_consistent and ((a == name and b in others) or (b == name and a in others))
    ]
    return shifts[0] if shifts and len(set(shifts)) == 1 and shifts[0] != 0 else None


def _fit_shift(
    first: MonocularCalibration, second: MonocularCalibration, frames: Sequence[str]
) -> _ShiftFit | None:
    """How the second camera's frames fit the first's; None where too few are shared to tell."""
    scatters = {
        shift: scatter
        for shift in SHIFTS
        if (scatter := _compute_scatter(first, second, frames, shift)) is not None
    }
    if 0 not in scatters:
        return None
    best = min(scatters, key=lambda shift: (scatters[shift], abs(shift)))
    if scatters[best] > CLEAR_IMPROVEMENT * scatters[0]:
        best = 0
    return _ShiftFit(best, scatters[best] < MAX_SCATTER)


def _compute_scatter(
    first: MonocularCalibration, second: MonocularCalibration, frames: Sequence[str], shift: int
) -> float | None:
    """Median scatter of the relative pose, as a share of the distance to the board."""
    poses: list[Pose] = []
    distances: list[float] = []
    for k, frame in enumerate(frames):
        other = frames[k + shift] if 0 <= k + shift < len(frames) else None
        if frame in first.cam_from_board and other in second.cam_from_board:
            pose = first.cam_from_board[frame]
            poses.append(second.cam_from_board[other] @ pose.inverse())
            distances.append(float(np.linalg.norm(pose.translation_mm)))
    if len(poses) < MIN_FRAMES:
        return None
    distance = float(np.median(distances))
    centers = np.array([pose.center_mm for pose in poses])
    axes = np.array([pose.rotation[2] for pose in poses]) * distance
    return float(np.hypot(_compute_spread(centers), _compute_spread(axes)) / distance)


def _compute_spread(points: NDArray[np.float64]) -> float:
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))
