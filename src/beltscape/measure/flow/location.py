"""Frames pushed to the flow meter, and the results of locating them on the belt.

A location holds a frame's position, what was observed of the belt's motion, and what is predicted.

The recount is of the belt that passed between the encoder's last agreement with the material and its contradiction.
An empty belt shows no motion: its frames are located by the encoder until material proves it wrong.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.findings import Finding, worst_effect
from beltscape.measure.belt.reference import MeasuredLoad
from beltscape.measure.flow.belt_motion import LEAST_RATIO, MAX_DISAGREEMENT, BeltPosition
from beltscape.measure.flow.encoder_check import Contradiction
from beltscape.measure.flow.registration import HighPassHeights, Shift


@dataclass(frozen=True, slots=True, eq=False)
class PushedFrame:
    """A frame pushed to the flow meter."""

    frame: str
    depth: DepthMap | None
    """None for a frame without a depth map."""
    time_ns: int | None
    clock: float
    """Seconds, or the frame's number without times."""
    encoder_mm: float | None
    """Reading of the encoder."""
    high_pass: HighPassHeights | None
    """High-pass heights, registered with those of the next frame."""
    whole: bool
    """Whether every camera gave its image."""
    number: int = 0
    """Number of the frame since the start."""
    findings: list[Finding] = field(default_factory=list)
    """The findings that concern it; those of later frames are added while it waits."""
    load: MeasuredLoad | None = None
    """What is added to the belt; None for a frame without a depth map."""

    @property
    def is_measured(self) -> bool:
        """Return whether its surface enters the measurement."""
        return self.depth is not None and worst_effect(self.findings) != "missing"


_REMEMBERED = 512
"""Number of latest frames that can be located anew: more than a view takes to pass at 30 frames/s and 0.05 m/s."""
_STEADY = 0.03
"""A belt whose speeds before and after differ by less kept its speed: its drive's slip changes it by as much."""
_LONGEST_S = 10.0
"""Longest time over which a belt is taken to have kept its speed; a belt stops and starts within it."""
_LONGEST_STILL_S = 60.0
"""The same beside an encoder that is proven to stand still: it shows no stop. Chosen: stops last longer."""


@dataclass(frozen=True, slots=True)
class LocatedFrame:
    """A frame with its position."""

    number: int
    """Number of the frame since the start."""
    frame: str
    place: BeltPosition
    moved_mm: float = 0.0
    """By how much this position differs from the one before the recount."""


@dataclass(frozen=True, slots=True)
class ProvenMotion:
    """The motion of the material that contradicts the encoder."""

    key: LocatedFrame
    """The frame from which on it is known."""
    speed: float
    """mm per unit of the clock, along the travel."""
    ratio: float
    """Encoder's over the material's motion; NaN if unknown."""
    free_mm: float
    """Length of belt without load at the older end of the key frame's view: so far may its position go back."""


class UnconfirmedTravel:
    """The frames since encoder and material last agreed; bounded in memory."""

    def __init__(self) -> None:
        self._confirmed: LocatedFrame | None = None
        self._speed: float | None = None
        self._since: deque[LocatedFrame] = deque(maxlen=_REMEMBERED)

    def add(self, located: LocatedFrame, speed: float | None, *, is_confirmed: bool) -> None:
        """Add a frame; ``is_confirmed``: the material shows its position. ``speed`` is the belt's."""
        if is_confirmed or self._confirmed is None:
            self._confirmed = located
            self._speed = speed if is_confirmed else None
            self._since.clear()
        else:
            self._since.append(located)

    def predict_motion_mm(self, elapsed: float) -> float | None:
        """Return the motion in a time by the last confirmed speed; None if unknown."""
        return None if self._speed is None else self._speed * elapsed

    @property
    def confirmed(self) -> int:
        """Return the number of the last frame whose position the material showed; -1 before."""
        return -1 if self._confirmed is None else self._confirmed.number

    def distribute(self, number: int, start: BeltPosition, speed: float) -> list[LocatedFrame]:
        """Return the frames after frame ``number`` at ``start`` with the positions that a constant speed gives."""
        return [
            replace(
                one,
                place=replace(one.place, position_mm=position),
                moved_mm=position - one.place.position_mm,
            )
            for one in self._since
            if one.number > number
            for position in (start.position_mm + speed * (one.place.clock - start.clock),)
        ]

    def relocate(self, proven: ProvenMotion) -> list[LocatedFrame]:
        """Return the frames since the last agreement with the positions that the proven motion gives them."""
        confirmed, key = self._confirmed, proven.key
        if confirmed is None or key.number <= confirmed.number:
            return []
        travel, uses_encoder = self._estimate_travel_mm(confirmed, proven)
        counted = key.place.position_mm - confirmed.place.position_mm
        travel = max(travel, counted - proven.free_mm)
        return list(self._distribute(confirmed, proven, travel, by_encoder=uses_encoder))

    def _estimate_travel_mm(self, confirmed: LocatedFrame, proven: ProvenMotion) -> tuple[float, bool]:
        """Return the travel from the last agreement to the key frame, and whether it is that of the encoder.

        It is that of a belt that kept its speed; else that of the encoder by its proven ratio, unless it is not
        plausible, as that of wild readings.
        """
        start, key = confirmed.place, proven.key.place
        elapsed = key.clock - start.clock
        by_encoder = _divide_steps(start, key, proven.ratio)
        if by_encoder is not None and elapsed > _LONGEST_S and proven.ratio > 0:
            by_encoder = None  # the scale may have been right for most of this time
        longest = _LONGEST_STILL_S if abs(proven.ratio) <= LEAST_RATIO else _LONGEST_S
        if self._speed is not None and elapsed <= longest:
            by_speed, change = 0.5 * (proven.speed + self._speed) * elapsed, abs(proven.speed - self._speed)
            if change <= _STEADY * abs(self._speed):
                return by_speed, False
            is_steady = elapsed <= _LONGEST_S and change <= MAX_DISAGREEMENT * abs(self._speed)
            if is_steady and not _is_plausible(by_encoder, by_speed):
                return by_speed, False
        if by_encoder is not None:
            return by_encoder, True
        return max(key.position_mm - start.position_mm, 0.0), False

    def _distribute(
        self, confirmed: LocatedFrame, proven: ProvenMotion, travel_mm: float, *, by_encoder: bool
    ) -> Iterator[LocatedFrame]:
        """Yield the frames at their share of the travel; those after the key frame follow by the proven speed."""
        start, key = confirmed.place, proven.key.place
        end_mm = start.position_mm + travel_mm
        before_mm = start.position_mm
        for one in self._since:
            if one.number > proven.key.number:
                position = end_mm + proven.speed * (one.place.clock - key.clock)
            elif by_encoder:
                step = _divide_steps(start, one.place, proven.ratio)
                position = before_mm if step is None else start.position_mm + step
            else:
                share = (one.place.clock - start.clock) / max(key.clock - start.clock, 1e-9)
                position = start.position_mm + share * travel_mm
            if one.number <= proven.key.number:
                position = end_mm if one.number == proven.key.number else min(position, end_mm)
            before_mm = max(position, before_mm)
            moved = before_mm - one.place.position_mm
            yield replace(one, place=replace(one.place, position_mm=before_mm), moved_mm=moved)


def _divide_steps(start: BeltPosition, end: BeltPosition, ratio: float) -> float | None:
    """Return the encoder's step between two frames over its ratio; None if unknown, or against the travel."""
    if start.encoder_mm is None or end.encoder_mm is None or not abs(ratio) > LEAST_RATIO:
        return None
    travel = (end.encoder_mm - start.encoder_mm) / ratio
    return travel if travel >= 0 else None


def _is_plausible(by_encoder: float | None, by_speed: float) -> bool:
    """Return whether a travel by the encoder is known and plausible beside that of a constant speed."""
    return by_encoder is not None and abs(by_encoder - by_speed) <= MAX_DISAGREEMENT * abs(by_speed)


@dataclass(frozen=True, slots=True)
class Location:
    """The position assigned to a frame."""

    place: BeltPosition | None
    """None: unknown."""
    shift: Shift | None
    """Motion of the material since the key frame."""
    is_encoder_trusted: bool
    contradiction: Contradiction | None
    """A contradiction between encoder and material that was noticed in this frame."""
    finding: Finding | None
    """The finding about the encoder; None without an encoder."""
    has_turned: bool
    """Whether the direction of travel, which was only assumed before, turned out to be the other one."""
    is_sudden: bool = False
    """Whether the encoder's speed changed faster than a belt's, and neither returned nor was confirmed since."""
    is_stalled: bool = False
    """Whether the frame shows the material where the frame before showed it, while a trusted encoder counts."""
    relocated: tuple[LocatedFrame, ...] = ()
    """Earlier frames with new positions: the contradiction shows that the encoder located them wrongly."""


MaterialState = Literal["unknown", "matched", "elsewhere", "standing"]
"""What a frame shows of the material's motion: nothing; the motion since the key frame; that the material is not
where a trusted encoder, or a standstill beside a distrusted one, puts it; that it stands while a trusted encoder
counts."""


@dataclass(frozen=True, slots=True)
class Observation:
    """The material's motion in a frame."""

    state: MaterialState = "unknown"
    shift: Shift | None = None
    """The motion since the key frame of matched material, else None."""
    contradiction: Contradiction | None = None
    """With the encoder."""


Verdict = Literal["resumed", "contradicted", "distrusted", "trusted"]
"""What is known of the encoder at a frame: it stood still and is now ahead; the frame contradicts it otherwise; it is
not trusted since an earlier frame; it is trusted."""


@dataclass(frozen=True, slots=True)
class Consequence:
    """What an observation changes."""

    earlier: Literal["kept", "relocated", "distributed"] = "kept"
    """Positions of the frames since the last agreement: unchanged; by the material's proven motion; evenly over an
    encoder's standstill."""
    encoder: Literal["kept", "distrusted", "compared"] = "kept"
    """Trust in the encoder: unchanged; lost; it may return, if the readings agree with a constant speed."""


_MATCHED: Mapping[Verdict, Consequence] = {
    "resumed": Consequence("distributed", "distrusted"),
    "contradicted": Consequence("relocated", "distrusted"),
    "distrusted": Consequence("relocated"),
    "trusted": Consequence(),
}
_NOT_MATCHED: Mapping[Verdict, Consequence] = {
    "resumed": Consequence("distributed", "distrusted"),
    "contradicted": Consequence(encoder="distrusted"),
    "distrusted": Consequence(encoder="compared"),
    "trusted": Consequence(encoder="compared"),
}


def select_consequence(state: MaterialState, verdict: Verdict) -> Consequence:
    """Return what an observation changes, given what is known of the encoder."""
    return (_MATCHED if state == "matched" else _NOT_MATCHED)[verdict]


@dataclass(frozen=True, slots=True, eq=False)
class MotionPrediction:
    """The prediction of the motion after a frame."""

    along: NDArray[np.float64]
    """(3,) direction of travel in the core's frame."""
    ratio: float
    """Encoder's over the material's motion."""
    speed: float | None
    """mm per unit of the meter's clock; None if unknown."""
    uses_encoder: bool = True
    """Whether the encoder is trusted."""

    def predict_step_mm(self, last: BeltPosition, clock: float, encoder_mm: float | None) -> float:
        """Return the travel from the last position to a coming frame; inf if it is not known."""
        if encoder_mm is not None and last.encoder_mm is not None and self.uses_encoder:
            return max((encoder_mm - last.encoder_mm) / self.ratio, 0.0)
        return float("inf") if self.speed is None else max(self.speed * (clock - last.clock), 0.0)


@dataclass(frozen=True, slots=True)
class FramePlacement:
    """The position assigned to one frame."""

    frame: str
    place: BeltPosition
    shift: Shift | None
    """Motion of the material since the key frame."""
    is_encoder_trusted: bool = True
    """Whether encoder and material agree as far as both are known."""
