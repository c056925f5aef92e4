"""Interfaces of the running system: frame sources, record sinks, operators' controls, observers."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Protocol

from beltscape.core.alarms import Alarm, AlarmControls
from beltscape.core.events import BeltStretch, CameraHealth, FrameEvent, Maintenance, ZeroProposal
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.ledger import BeltRecord, Totals


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

    def on_measured(self, records: Sequence[BeltRecord]) -> None:
        """Handle records that are measured and not on disk yet: they are what is so now."""

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
        """Handle the beginning and the end of maintenance; None: there is none."""

    def on_message(self, message: str) -> None:
        """Handle a message of one line."""


class Observers:
    """Passes events on to several observers. The failure of one is logged; the others and the run go on."""

    def __init__(self, observers: Sequence[Observer]) -> None:
        self._observers = tuple(observers)

    def on_frame(self, event: FrameEvent) -> None:
        """Pass the event on."""
        self._notify(lambda observer: observer.on_frame(event))

    def on_measured(self, records: Sequence[BeltRecord]) -> None:
        """Pass the event on."""
        self._notify(lambda observer: observer.on_measured(records))

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
