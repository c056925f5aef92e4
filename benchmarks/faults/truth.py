"""The ledger of a row against the truth of the rendered heap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from beltscape.core.ledger import BeltRecord
from faults.capture import RoundCapture


@dataclass(frozen=True)
class Comparison:
    """Records with the true belt and the true volume that they stand for."""

    records: Sequence[BeltRecord]
    true_mm: np.ndarray
    """(N,) length of belt that passed in truth."""
    true_mm3: np.ndarray
    """(N,) volume on it."""

    def select(self, standings: Sequence[str], is_used: Sequence[bool]) -> Selection:
        """Return sums over the used records of these standings."""
        chosen = [i for i, r in enumerate(self.records) if is_used[i] and r.standing in standings]
        return Selection(
            sum(self.records[i].length_mm for i in chosen),
            float(self.true_mm[chosen].sum()),
            sum(self.records[i].volume_mm3 for i in chosen),
            float(self.true_mm3[chosen].sum()),
            min(sum(self.records[i].sigma_mm3 for i in chosen), self.records[-1].run_sigma_mm3),
        )


@dataclass(frozen=True)
class Selection:
    """Sums over records."""

    length_mm: float
    true_mm: float
    volume_mm3: float
    true_mm3: float
    sigma_mm3: float
    """Sum of the records' σ, as if their errors were common, but not more than the run's own σ."""

    @property
    def relative_error(self) -> float:
        """Return the volume's error as a share of the truth."""
        return self.volume_mm3 / self.true_mm3 - 1 if self.true_mm3 > 0 else 0.0

    def covers_truth(self, factor: float = 2.5) -> bool:
        """Return whether the truth lies within ``factor`` σ, but for 0.1 litres."""
        return abs(self.volume_mm3 - self.true_mm3) <= factor * self.sigma_mm3 + 1e5


def compare(
    capture: RoundCapture, records: Sequence[BeltRecord], sound: int, show: Callable[[int], int] = int
) -> Comparison:
    """Return the true belt and volume of every record; the first ``sound`` ones were measured before the fault.

    ``show`` gives the frame of the endless belt that a delivered one shows.

    A record stands for the belt that became new in its frame, whose true position is known. Where the heap lies in
    the ledger's positions is fitted to the sound records.
    """
    ends = _true_ends(capture, records, sound, show)
    starts = np.concatenate([[records[0].belt_mm[0] + ends[0] - records[0].belt_mm[1]], ends[:-1]])
    shift = _fit_shift(capture, records[:sound], starts[:sound], ends[:sound])
    return Comparison(records, ends - starts, _true_volumes(capture, starts, ends, shift))


def _true_ends(
    capture: RoundCapture, records: Sequence[BeltRecord], sound: int, show: Callable[[int], int]
) -> np.ndarray:
    """Return (N,) the true belt position of each record's end."""
    travel = np.array(
        [np.nan if r.strip is None else capture.position_mm(show(int(r.strip.frame))) for r in records]
    )
    ledger = np.array([r.belt_mm[1] for r in records])
    view = float(np.nanmedian((ledger - travel)[: max(sound, 1)]))
    ends = travel + view
    for i in np.flatnonzero(np.isnan(ends)).tolist():  # belt without a frame: its own length follows
        ends[i] = (ends[i - 1] if i else records[0].belt_mm[0]) + records[i].length_mm
    return np.maximum.accumulate(ends)


def _true_volumes(capture: RoundCapture, starts: np.ndarray, ends: np.ndarray, shift_mm: float) -> np.ndarray:
    """Return (N,) the volume between belt positions; the heap's own y is ``shift_mm`` less the position."""
    y, area = capture.area
    round_mm = capture.round_mm
    step = float(y[1] - y[0])
    cumulated = np.concatenate([[0.0], np.cumsum(area) * step])
    edges = np.append(y - step / 2, y[-1] + step / 2)
    first = edges[0]

    def cumulate(own: np.ndarray) -> np.ndarray:
        rounds = np.floor((own - first) / round_mm)
        return rounds * cumulated[-1] + np.interp(own - rounds * round_mm, edges, cumulated)

    return cumulate(shift_mm - starts) - cumulate(shift_mm - ends)


def _fit_shift(
    capture: RoundCapture, records: Sequence[BeltRecord], starts: np.ndarray, ends: np.ndarray
) -> float:
    """Return where the heap lies, mm, by least squares over the records' volumes."""
    measured = np.array([r.volume_mm3 for r in records])
    used = np.array([r.standing != "missing" for r in records])

    def misfit(shift: float) -> float:
        return float(((_true_volumes(capture, starts, ends, shift) - measured)[used] ** 2).sum())

    coarse = min(np.arange(0.0, capture.round_mm, 4.0), key=misfit)
    return float(min(np.arange(coarse - 6.0, coarse + 6.0, 0.25), key=misfit))
