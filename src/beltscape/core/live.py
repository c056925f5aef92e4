"""The running system's events, state and interfaces: frames, camera health, sources, sinks, observers."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from beltscape.core.alarms import Alarm, AlarmControls
from beltscape.core.belt.ledger_entries import BeltRecord, Totals
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet

CameraState = Literal["ok", "waiting", "lost", "unusable"]
"""ok; no image yet; no image for too long; images unusable (overexposed, dark, another size)"""


@dataclass(frozen=True, slots=True)
class CameraHealth:
    """The state of one camera."""

    name: str
    state: CameraState
    frames: int
    """Images taken since the start."""
    missed: int
    """Trigger instants since the start without an image from it."""
    rate_hz: float
    """Images per second over the last seconds; 0 without images."""
    skew_ms: float
    """Time from the core's last image to this camera's, by the cameras' own clocks; NaN: not known."""
    message: str = ""
    """The fault and the fix in one line; empty without a fault."""


@dataclass(frozen=True, slots=True, eq=False)
class BeltStretch:
    """A finished stretch of the fused belt, for display."""

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
class FrameEvent:
    """A frame set that has been processed, with the state of the queue."""

    frames: FrameSet
    done: int
    """Frame sets measured since the start."""
    dropped: int
    """Frame sets skipped since the start because newer ones were waiting."""
    waiting: int
    """Frame sets in the queue."""
    seconds: float
    """Time from the last image's arrival to the end of its measurement."""
    coverage: float
    """Share of the core's pixels that were measured; 0 where the frame gave none."""
    speed_mm_s: float
    """Speed of the belt; NaN: not known."""
    largest_lump_mm: float = math.nan
    """Sieve size of the largest lump at the last search; 0: there was none; NaN: none was made."""
    full_area_mm2: float = math.nan
    """Cross-section of the fully loaded belt; NaN: not known."""


@dataclass(frozen=True, slots=True)
class Maintenance:
    """A period in which people work at the system: belt that passes is missing, alarms of measurement are held."""

    reason: str
    """Such as "cleaning"."""
    by: str
    """Name of the user that began it."""
    since_ns: int
    """System clock when it began."""
    until_ns: int
    """System clock when it ends by itself."""


@dataclass(frozen=True, slots=True)
class ZeroProposal:
    """The measured motion of the empty belt since it was learned, which setting the zero accounts for."""

    number: int
    """Names it when it is confirmed."""
    offset_mm: float
    """Mean rise of the belt."""
    sigma_mm: float
    """One standard deviation of it."""
    tilt_mm: float
    """Largest rise of an edge or end of the view by tilt or lateral shift."""
    frames: int
    """Number of frames that were measured."""
    limit_mm: float
    """Largest rise or tilt that is accepted."""


class LiveSource(Protocol):
    """A frame source that runs until it is closed; iterating blocks until the next trigger instant."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras it should have."""
        ...

    def __iter__(self) -> Iterator[FrameSet]: ...

    def health(self) -> Mapping[str, CameraHealth]:
        """Return the state of every camera; from any thread, at any time."""
        ...

    def close(self) -> None:
        """Stop the source; the iteration ends."""
        ...


class RecordSink(Protocol):
    """A destination of finished records; they are stored when ``write`` returns."""

    def write(self, records: Sequence[BeltRecord]) -> None:
        """Store the records in order; after an OutputError the caller repeats the call with the same records."""
        ...

    def close(self) -> None:
        """End the sink; no more records follow."""
        ...


class Controls(Protocol):
    """Operator actions on a running system; each call returns whether it had an effect."""

    @property
    def alarm_controls(self) -> AlarmControls:
        """The further actions on alarms."""
        ...

    def acknowledge(self, alarm: str, by: str) -> bool:
        """Acknowledge the alarm of that name."""
        ...

    def keep_recording(self, reason: str, by: str) -> bool:
        """Keep the frames that the recording ring holds now."""
        ...

    def begin_maintenance(self, reason: str, minutes: float, by: str) -> bool:
        """Begin maintenance, or set its reason and end anew: the belt that passes during it is missing."""
        ...

    def end_maintenance(self, by: str) -> bool:
        """End maintenance before its time."""
        ...

    def learn_images(self, by: str) -> bool:
        """Learn anew what sound images show; OutputError if what is kept of them cannot be removed."""
        ...

    def measure_zero(self) -> ZeroProposal:
        """Return the empty belt's motion since it was learned, from the next frames; MeasureError if it has none."""
        ...

    def set_zero(self, number: int, by: str) -> bool:
        """Set the zero to a measured one; OutputError if it cannot be kept."""
        ...


class Observer(Protocol):
    """Receives the events of a running system; every method must return at once."""

    def on_frame(self, event: FrameEvent) -> None:
        """Handle a processed frame set."""

    def on_records(self, records: Sequence[BeltRecord], totals: Totals) -> None:
        """Handle records that are on disk, and the totals with them."""

    def on_surface(self, stretch: BeltStretch) -> None:
        """Handle a further finished piece of the belt."""

    def on_health(self, cameras: Mapping[str, CameraHealth]) -> None:
        """Handle the health of all cameras; called about once a second."""

    def on_alarms(self, alarms: Sequence[Alarm]) -> None:
        """Handle the current state of all alarms."""

    def on_findings(self, findings: Sequence[Finding]) -> None:
        """Handle the findings of the system's checks of one frame set."""

    def on_maintenance(self, maintenance: Maintenance | None) -> None:
        """Handle the begin and the end of maintenance; None: there is none."""

    def on_message(self, message: str) -> None:
        """Handle a message of one line."""


class Observers:
    """Passes events on to several observers. The failure of one is logged; the others and the run go on."""

    def __init__(self, observers: Sequence[Observer]) -> None:
        self._observers = tuple(observers)

    def on_frame(self, event: FrameEvent) -> None:
        """Pass the event on."""
        self._notify(lambda observer: observer.on_frame(event))

    def on_records(self, records: Sequence[BeltRecord], totals: Totals) -> None:
        """Pass the event on."""
        self._notify(lambda observer: observer.on_records(records, totals))

    def on_surface(self, stretch: BeltStretch) -> None:
        """Pass the event on."""
        self._notify(lambda observer: observer.on_surface(stretch))

    def on_health(self, cameras: Mapping[str, CameraHealth]) -> None:
        """Pass the event on."""
        self._notify(lambda observer: observer.on_health(cameras))

    def on_alarms(self, alarms: Sequence[Alarm]) -> None:
        """Pass the event on."""
        self._notify(lambda observer: observer.on_alarms(alarms))

    def on_findings(self, findings: Sequence[Finding]) -> None:
        """Pass the event on."""
        self._notify(lambda observer: observer.on_findings(findings))

    def on_maintenance(self, maintenance: Maintenance | None) -> None:
        """Pass the event on."""
        self._notify(lambda observer: observer.on_maintenance(maintenance))

    def on_message(self, message: str) -> None:
        """Pass the event on."""
        self._notify(lambda observer: observer.on_message(message))

    def _notify(self, call: Callable[[Observer], None]) -> None:
        for observer in self._observers:
            try:
                call(observer)
            except Exception:
                logging.getLogger("beltscape").exception(
                    "%s failed; the run continues", type(observer).__name__
                )
