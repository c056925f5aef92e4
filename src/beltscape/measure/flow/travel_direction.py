"""The check of the material's motion against the belt's axis: a belt frame that is turned miscounts every strip.

A flat belt without visible edges has the direction of the camera, a given one may be wrong, and a rig may turn after
its empty belt was learned. The material shows it: it moves sideways in the belt's frame. Where no shift along the
axis fits the load of two frames, all shifts in the plane are tried (masked normalised correlation: Padfield, IEEE
Trans. Image Process. 21(5), 2012, doi:10.1109/TIP.2011.2181402).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from beltscape.core.alarm_catalogue import TRAVEL_DIRECTION
from beltscape.core.empty_belt import Belt
from beltscape.core.findings import Finding
from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.core.translatable_message import make_message
from beltscape.measure.flow.registration import (
    CLEAR_MARGIN,
    NEXT_MM,
    HighPassHeights,
    Shift,
    normalise_correlation,
)

LIMIT_DEG = 2.0
"""A turn by 2° makes a volume 0.06 % too large; the lateral wander of a belt turns its load by less. Chosen."""
_SIGMAS = 3.0
"""Number of σ by which a turn exceeds nothing."""
_LEAST_MM = 40.0
"""Shorter motions do not determine a direction: an error of a cell would turn them by several degrees."""
_LEAST_SAMPLES = 3
"""Number of motions that agree: one may be a match by chance."""
_KEPT = 9
"""Number of latest motions that are kept."""
_TRIES = 12
"""Number of pairs of frames that are searched in the plane until one matches; a search costs ten registrations."""
_LEAST_SCORE = 0.5
"""Least correlation of a match, a little more than along the axis: more shifts are tried."""
_LEAST_COMMON = 0.05
"""Least share of the grid that is load in both frames. Chosen."""
_PEAK_CELLS = 0.15
"""σ of a motion in the plane, in cells: the peak's top is that of a parabola; half of it on simulated heaps."""
_LEAST_SIGMA_DEG = 0.1
"""σ of a direction is never less: the lateral wander of a belt."""
_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class PlaneShift:
    """Motion of the load between two frames in the belt's plane."""

    across_mm: float
    along_mm: float
    sigma_mm: float
    """One standard deviation of both."""


def register_in_plane(before: HighPassHeights, after: HighPassHeights) -> PlaneShift | None:
    """Register the loads of two frames over all shifts; None where no shift is clearly the best."""
    if not (before.has_load and after.has_load):
        return None
    shape = before.load.shape
    size = [fft.next_fast_len(2 * side - 1, real=True) for side in shape]

    def spectra(of: HighPassHeights) -> list[NDArray[np.complex64]]:
        values = of.high_pass_mm.astype(np.float32)
        return [np.asarray(fft.rfft2(part, size)) for part in (of.load.astype(np.float32), values, values**2)]

    one, two = spectra(before), spectra(after)

    def correlate(i: int, j: int) -> NDArray[np.float32]:
        return np.asarray(fft.irfft2(one[i].conj() * two[j], size), np.float32)

    number = np.maximum(np.rint(correlate(0, 0)), 0)
    least = _LEAST_COMMON * before.load.size
    sums, squares = (correlate(1, 0), correlate(0, 1)), (correlate(2, 0), correlate(0, 2))
    score = normalise_correlation(number, sums, squares, correlate(1, 1), least)
    rows, columns = (np.fft.fftfreq(side, 1 / side) for side in size)
    best = np.unravel_index(int(np.argmax(score)), score.shape)
    down, right = rows[best[0]] * before.cell_mm, columns[best[1]] * before.cell_mm
    parts = [
        _find_vertex(np.asarray(np.roll(score, -best[1 - axis], 1 - axis).take(0, 1 - axis)), best[axis])
        for axis in (0, 1)
    ]
    apart = np.hypot(rows[:, None] * before.cell_mm - down, columns[None] * before.cell_mm - right) > NEXT_MM
    next_best = float(score[apart].max(initial=-1.0))
    if score[best] < _LEAST_SCORE or score[best] - next_best < CLEAR_MARGIN:
        return None
    across, along = right + parts[1] * before.cell_mm, down + parts[0] * before.cell_mm
    return PlaneShift(float(across), float(along), _PEAK_CELLS * before.cell_mm)


def _find_vertex(score: NDArray[np.floating], best: np.intp) -> float:
    """Return where the parabola through the best of a closed line of scores (N,) and its neighbours has its top."""
    before, top, after = (float(score[(best + step) % len(score)]) for step in (-1, 0, 1))
    bend = before - 2 * top + after
    return 0.5 * (before - after) / bend if min(before, after) > -1 and bend < 0 else 0.0


class TravelDirectionCheck:
    """Collects the directions of the material's motion; bounded in memory."""

    def __init__(self, belt: Belt) -> None:
        self._belt = belt
        self._angles_deg: deque[float] = deque(maxlen=_KEPT)
        """Of each motion against the belt's axis, towards +x."""
        self._before: HighPassHeights | None = None
        self._tries = 0
        self._sigma_deg = _NAN
        """σ of the latest direction."""

    def follow(self, heights: HighPassHeights, shift: Shift | None) -> Finding:
        """Return the finding after a frame; ``shift`` is its registration along the axis, None where none fits."""
        before, self._before = self._before, heights
        moved: PlaneShift | None = None
        if shift is not None:
            self._tries = 0
            moved = PlaneShift(shift.across_mm, shift.along_mm, shift.sigma_mm)
        elif before is not None and self._tries < _TRIES and before.has_load and heights.has_load:
            self._tries += 1
            moved = register_in_plane(before, heights)
        if moved is not None and (length := float(np.hypot(moved.across_mm, moved.along_mm))) >= _LEAST_MM:
            self._tries = 0
            self._angles_deg.append(float(np.degrees(np.arctan(moved.across_mm / (moved.along_mm or 1e-9)))))
            self._sigma_deg = float(np.degrees(moved.sigma_mm / length))
        return self._make_finding()

    def _make_finding(self) -> Finding:
        if len(self._angles_deg) < _LEAST_SAMPLES:
            return Finding(TRAVEL_DIRECTION, _NAN, _NAN, LIMIT_DEG, "°")
        angles = np.array(self._angles_deg)
        angle = float(np.median(angles))
        scatter = MAD_TO_SIGMA * float(np.median(np.abs(angles - angle)))
        # equal steps of the belt have the error of the peak in common
        sigma = float(np.hypot(np.hypot(scatter / np.sqrt(len(angles)), _LEAST_SIGMA_DEG), self._sigma_deg))
        if abs(angle) <= LIMIT_DEG + _SIGMAS * sigma:
            return Finding(TRAVEL_DIRECTION, angle, sigma, LIMIT_DEG, "°")
        turn = round(abs(angle), 1)
        if self._belt.yaw_from in ("shape", "edges"):
            text = make_message("travel_direction", angle=turn)
        else:
            travel = round(self._convert_to_travel_deg(angle), 1)
            text = make_message("travel_direction_given", angle=turn, travel=travel)
        # a section that is cut askew is larger by the cosine
        relative = 1 / max(float(np.cos(np.radians(angle))), 0.05) - 1
        return Finding(
            TRAVEL_DIRECTION, angle, sigma, LIMIT_DEG, "°",
            text=text, effect="degraded", relative_sigma=min(1.0, relative),
        )  # fmt: skip

    def _convert_to_travel_deg(self, angle_deg: float) -> float:
        """Return the direction of travel against the core image's columns, as ``measure belt --travel`` takes it."""
        angle = np.radians(angle_deg)
        along = self._belt.belt_from_core.rotation.T @ np.array([np.sin(angle), np.cos(angle), 0.0])
        return float((np.degrees(np.arctan2(-along[0], along[1])) + 90) % 180 - 90)
