"""Check of synchronisation: frames of one name belong to one instant if the relative poses of the cameras agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from beltscape.calibration.intrinsics.zhang import MonocularCalibration
from beltscape.core.arrays import Array

SHIFTS = range(-3, 4)
"""Frame shifts that are tested, also of reversed frames: those without a board at the ends are not counted."""
MIN_FRAMES = 5
"""Least number of shared frames for a scatter."""
CLEAR_IMPROVEMENT = 0.2
"""A shift is accepted if it leaves less than this share of the scatter."""
MAX_SCATTER = 0.05
"""Relative poses are inconsistent if they scatter by more than this share of the board's distance."""


@dataclass(frozen=True, slots=True)
class FrameMisfit:
    """A camera whose frames belong to other instants than those of the others."""

    camera: str
    shift: int | None
    """The others' frame number k is its number k + shift; None: no shift makes the poses consistent."""
    others: tuple[str, ...]
    """The cameras that it disagrees with."""
    is_reversed: bool = False
    """Whether the poses are consistent with its frames in the reversed order."""

    def describe(self) -> str:
        """Return the fault and the fix in one line."""
        against = ", ".join(self.others)
        if self.is_reversed:
            return (
                f"camera {self.camera}: its frames are in the reversed order against {against}, the first one is "
                "their last; number its images the other way round"
            )
        if self.shift is None:
            return (
                f"camera {self.camera}: its frames do not belong to those of {against} of the same name; "
                "check its trigger or the names of its images"
            )
        direction = "low" if self.shift < 0 else "high"
        return (
            f"camera {self.camera}: its frame numbers are {abs(self.shift)} too {direction} against {against}; "
            "rename its images"
        )


def find_frame_misfits(
    cameras: Mapping[str, MonocularCalibration], frames: Sequence[str]
) -> tuple[FrameMisfit, ...]:
    """Return the cameras whose frames are shifted against the majority's, or belong to other instants.

    The relative pose of two rigidly mounted cameras is the same in every frame. If it scatters, their frames of one
    name do not belong to one instant.
    """
    tracks = {name: _Track.of(camera, frames) for name, camera in cameras.items()}
    fits = {
        (a, b): fit
        for a, b in combinations(cameras, 2)
        if (fit := _fit_shift(tracks[a], tracks[b])) is not None
    }
    together = _find_largest_consistent(list(cameras), fits)
    return tuple(
        _describe_misfit(name, together, fits)
        for name in cameras
        if name not in together and _is_mostly_inconsistent(name, together, fits)
    )


@dataclass(frozen=True, slots=True)
class _ShiftFit:
    shift: int
    """Frames by which the second camera's names must be shifted to fit the first's."""
    is_consistent: bool
    """Whether the relative poses agree after the shift."""
    is_reversed: bool = False
    """Whether the second camera's frames are reversed before they are shifted."""

    @property
    def is_synchronous(self) -> bool:
        return self.is_consistent and self.shift == 0 and not self.is_reversed


def _find_largest_consistent(names: Sequence[str], fits: Mapping[tuple[str, str], _ShiftFit]) -> list[str]:
    """Return the largest set of cameras without a disagreement, grown from each camera; the first of equal ones."""
    groups: list[list[str]] = []
    for first_name in names:
        group = [first_name]
        for name in names:
            if name != first_name and all(_is_synchronous(name, other, fits) is not False for other in group):
                group.append(name)
        groups.append([name for name in names if name in group])
    return max(groups, key=len) if groups else []


def _is_mostly_inconsistent(
    name: str, others: Sequence[str], fits: Mapping[tuple[str, str], _ShiftFit]
) -> bool:
    results = [result for other in others if (result := _is_synchronous(name, other, fits)) is not None]
    return 2 * results.count(False) > len(results)


def _is_synchronous(a: str, b: str, fits: Mapping[tuple[str, str], _ShiftFit]) -> bool | None:
    """Return whether two cameras are synchronous; None with too few shared frames."""
    fit = fits.get((a, b)) or fits.get((b, a))
    return None if fit is None else fit.is_synchronous


def _describe_misfit(
    name: str, others: Sequence[str], fits: Mapping[tuple[str, str], _ShiftFit]
) -> FrameMisfit:
    """Return the misfit of a camera, with the order of its frames that all others agree on, if there is one."""
    consistent = [
        (fit, fit.shift if b == name else -fit.shift)
        for (a, b), fit in fits.items()
        if fit.is_consistent and ((a == name and b in others) or (b == name and a in others))
    ]
    if consistent and all(fit.is_reversed for fit, _ in consistent):
        return FrameMisfit(name, None, tuple(others), is_reversed=True)
    shifts = {0 if fit.is_reversed else shift for fit, shift in consistent}
    shift = shifts.pop() if len(shifts) == 1 else 0
    return FrameMisfit(name, shift or None, tuple(others))


@dataclass(frozen=True, slots=True, eq=False)
class _Track:
    """Poses of the board against one camera over all frames, in order; NaN where the camera did not see it."""

    rotation: Array
    """(F, 3, 3) cam_from_board."""
    translation_mm: Array
    """(F, 3)."""

    @classmethod
    def of(cls, camera: MonocularCalibration, frames: Sequence[str]) -> _Track:
        rotation, translation = np.full((len(frames), 3, 3), np.nan), np.full((len(frames), 3), np.nan)
        for k, frame in enumerate(frames):
            if frame in camera.cam_from_board:
                pose = camera.cam_from_board[frame]
                rotation[k], translation[k] = pose.rotation, pose.translation_mm
        return cls(rotation, translation)

    def reverse(self) -> _Track:
        """Return the track whose first frame is this one's last."""
        return _Track(self.rotation[::-1], self.translation_mm[::-1])

    def shift(self, frames: int) -> _Track:
        """Return the track whose frame k is this one's k + ``frames``."""
        rotation, translation = np.full_like(self.rotation, np.nan), np.full_like(self.translation_mm, np.nan)
        count = len(rotation)
        source = slice(max(frames, 0), count + min(frames, 0))
        target = slice(max(-frames, 0), count - max(frames, 0))
        rotation[target], translation[target] = self.rotation[source], self.translation_mm[source]
        return _Track(rotation, translation)


def _fit_shift(first: _Track, second: _Track) -> _ShiftFit | None:
    """Fit the order of the second camera's frames to the first's; return None with too few shared frames."""
    named = False, 0
    scatters = _compute_scatters(first, second, is_reversed=False)
    if named not in scatters:
        return None
    if scatters[named] >= MAX_SCATTER:
        scatters |= _compute_scatters(first, second.reverse(), is_reversed=True)
    best = min(scatters, key=lambda order: (scatters[order], order[0], abs(order[1])))
    if scatters[best] > CLEAR_IMPROVEMENT * scatters[named]:
        best = named
    is_reversed, shift = best
    return _ShiftFit(shift, scatters[best] < MAX_SCATTER, is_reversed)


def _compute_scatters(first: _Track, second: _Track, *, is_reversed: bool) -> dict[tuple[bool, int], float]:
    """Return the scatter for every shift of the second camera's frames that leaves enough of them shared."""
    return {
        (is_reversed, shift): scatter
        for shift in SHIFTS
        if abs(shift) < len(first.rotation)
        and (scatter := _compute_scatter(first, second.shift(shift))) is not None
    }


def _compute_scatter(first: _Track, second: _Track) -> float | None:
    """Return the median scatter of the relative pose over the board's distance; None with too few frames."""
    shared = np.isfinite(first.translation_mm[:, 0]) & np.isfinite(second.translation_mm[:, 0])
    if shared.sum() < MIN_FRAMES:
        return None
    a, b = first.rotation[shared], second.rotation[shared]
    rotation = b @ a.swapaxes(1, 2)
    translation = second.translation_mm[shared] - np.einsum(
        "nij,nj->ni", rotation, first.translation_mm[shared]
    )
    # centres of the second camera in the first one's frame
    centers = -np.einsum("nji,nj->ni", rotation, translation)
    distance = float(np.median(np.linalg.norm(first.translation_mm[shared], axis=1)))
    return float(np.hypot(_compute_spread(centers), _compute_spread(rotation[:, 2] * distance)) / distance)


def _compute_spread(points: Array) -> float:
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))
