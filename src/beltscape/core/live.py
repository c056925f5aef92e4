"""What a running system says of itself, and to whom."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt_record import BeltRecord, Totals
from beltscape.core.frames import FrameSet

CameraState = Literal["ok", "waiting", "lost", "unusable"]
"""ok; not heard of yet; silent for too long; its images cannot be used (overexposed, dark, another size)"""


@dataclass(frozen=True, slots=True)
class CameraHealth:
    """How one camera does."""

    name: str
    state: CameraState
    frames: int
    """Images taken since the start."""
    missed: int
    """Trigger instants since the start of which it gave none."""
    rate_hz: float
    """Images per second over the last seconds; 0 where none came."""
    skew_ms: float
    """How far its last image was from the core's, by the cameras' own clocks; NaN: not known."""
    message: str = ""
    """What is wrong and the mend, in one line; empty where nothing is."""


@dataclass(frozen=True, slots=True, eq=False)
class BeltStretch:
    """A finished piece of the fused belt, for pictures."""

    start_mm: float
    """Belt coordinate of its first row."""
    cell_mm: float
    """Distance of rows."""
    x_mm: NDArray[np.float32]
    """(Nx,) float32 across the belt."""
    height_mm: NDArray[np.float32]
    """(n, Nx) float32 load over the empty belt, holes filled."""
    measured: NDArray[np.bool_]
    """(n, Nx) where a frame measured it."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """One frame set that has gone through."""

    frames: FrameSet
    done: int
    """Frame sets measured since the start."""
    dropped: int
    """Frame sets left out since the start because the ones after them were already there."""
    waiting: int
    """Frame sets in the queue."""
    seconds: float
    """From the last image's arrival to its measurement."""
    coverage: float
    """Share of the core's pixels that were measured; 0 where the frame gave none."""
    speed_mm_s: float
    """Of the belt; NaN: not known."""


AlarmState = Literal["clear", "raised", "acknowledged", "gone"]
"""nothing; on and nobody has seen it; on and seen; over, but nobody has seen it"""
Severity = Literal["info", "warning", "critical"]


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm as it stands."""

    name: str
    """Its key, such as "overload"; one a camera: "camera_lost:cam2"."""
    severity: Severity
    state: AlarmState
    value: float
    """What it was judged by; NaN where that is no number."""
    limit: float
    """What it is held against; NaN where that is no number."""
    unit: str
    since_ns: int | None
    """System clock when it was raised; None while clear."""
    detail: str = ""
    """What is wrong and the mend, in one line."""
    by: str = ""
    """Who acknowledged it."""


class LiveSource(Protocol):
    """A frame source that goes on until it is closed; iterating blocks until the next trigger instant."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras it should have."""
        ...

    def __iter__(self) -> Iterator[FrameSet]: ...

    def health(self) -> Mapping[str, CameraHealth]:
        """How every camera does, at any time, from any thread."""
        ...

    def close(self) -> None:
        """Stop; the iteration ends."""
        ...


class RecordSink(Protocol):
    """Takes finished records; what it has taken when ``write`` returns is kept."""

    def write(self, records: Sequence[BeltRecord]) -> None:
        """Keep them, in order. OutputError where it cannot: it is then asked again with the same records."""
        ...

    def close(self) -> None:
        """No more come."""
        ...


class Controls(Protocol):
    """What people may ask of a running system; each call says whether it did something."""

    def acknowledge(self, alarm: str, by: str) -> bool:
        """Somebody has seen the alarm of that name."""
        ...

    def keep_recording(self, reason: str, by: str) -> bool:
        """Keep what the ring of recorded frames holds now."""
        ...


class Observer(Protocol):
    """Shown what happens; must return at once."""

    def saw(self, sight: Sight) -> None:
        """A frame set went through."""

    def measured(self, records: Sequence[BeltRecord], totals: Totals) -> None:
        """Records were acknowledged; the totals with them."""

    def surfaced(self, stretch: BeltStretch) -> None:
        """A further piece of the belt is finished."""

    def health(self, cameras: Mapping[str, CameraHealth]) -> None:
        """How the cameras do, once a second or so."""

    def alarmed(self, alarms: Sequence[Alarm]) -> None:
        """All alarms as they stand, whenever one changes."""

    def noted(self, message: str) -> None:
        """Something worth knowing, in one line."""


class Observers:
    """Several as one; one that fails is told of in the log, and hurts neither the others nor the measurement."""

    def __init__(self, each: Sequence[Observer]) -> None:
        self._each = tuple(each)

    def saw(self, sight: Sight) -> None:
        """Pass it on."""
        self._tell(lambda one: one.saw(sight))

    def measured(self, records: Sequence[BeltRecord], totals: Totals) -> None:
        """Pass it on."""
        self._tell(lambda one: one.measured(records, totals))

    def surfaced(self, stretch: BeltStretch) -> None:
        """Pass it on."""
        self._tell(lambda one: one.surfaced(stretch))

    def health(self, cameras: Mapping[str, CameraHealth]) -> None:
        """Pass it on."""
        self._tell(lambda one: one.health(cameras))

    def alarmed(self, alarms: Sequence[Alarm]) -> None:
        """Pass it on."""
        self._tell(lambda one: one.alarmed(alarms))

    def noted(self, message: str) -> None:
        """Pass it on."""
        self._tell(lambda one: one.noted(message))

    def _tell(self, call: Callable[[Observer], None]) -> None:
        for one in self._each:
            try:
                call(one)
            except Exception:
                logging.getLogger("beltscape").exception("%s failed; going on", type(one).__name__)
