"""The thread that reads a belt scale's counter and tells where scale and known density disagree."""

from __future__ import annotations

import threading
from collections.abc import Callable
from time import time_ns

from beltscape.core.errors import BeltscapeError
from beltscape.core.runtime.supervision import make_supervised_thread
from beltscape.report.production.document import BatchOut
from beltscape.service.production.figures import ProductionFigures
from beltscape.service.production.scale_counter import ScaleCounter
from beltscape.sinks.historian import Historian

_BATCHES = 20
"""Newest batches that are compared; an older one changes no more unless a reading is typed for it."""
_EVENT = "scale"
_EVENTS = 10_000
"""Newest events among which those of a scale are searched: more than a plant has in a week."""
_END_OF_TIME_NS = 1 << 62
"""A time after every event."""
_WEEK_NS = 7 * 86_400 * 10**9
"""A batch that ended earlier is not told any more."""


class ScaleWatch:
    """Reads the counter and compares new batches until it is closed."""

    def __init__(
        self,
        figures: ProductionFigures,
        historian: Historian,
        counter: ScaleCounter | None,
        every_s: float,
        on_message: Callable[[str], None],
    ) -> None:
        """``counter``: None where a person types it."""
        self._figures, self._historian, self._counter = figures, historian, counter
        self._every_s, self._on_message = every_s, on_message
        self._stop, self._trouble = threading.Event(), ""
        events = historian.events(0, _END_OF_TIME_NS, _EVENTS)
        self._reported = {event.name for event in events if event.kind == _EVENT}
        self._thread = make_supervised_thread("scale", self._run, self._tell, self._stop.wait)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self, patience_s: float = 5.0) -> None:
        """Stop it."""
        self._stop.set()
        self._thread.join(patience_s)
        if self._counter is not None:
            self._counter.close()

    def _run(self) -> None:
        while True:
            try:
                self.read()
                self.compare(time_ns())
                self._trouble = ""
            except BeltscapeError as error:
                self._tell(str(error))
            if self._stop.wait(self._every_s):
                return

    def read(self) -> None:
        """Store the counter's new readings."""
        if self._counter is not None:
            self._figures.control.history.add_readings(self._counter.read())

    def compare(self, now_ns: int) -> None:
        """Tell the complete batches of the last week whose weighing disagrees with the known density, once each."""
        for batch in self._figures.list_batches(now_ns - _WEEK_NS, now_ns, _BATCHES):
            if batch.scale is not None and batch.scale.disagrees and batch.complete:
                self._report(batch, now_ns)

    def _report(self, batch: BatchOut, now_ns: int) -> None:
        name, scale = str(batch.number), batch.scale
        if name in self._reported or scale is None or scale.deviation_t is None:
            return
        self._reported.add(name)
        deviation = f"{scale.deviation_t:+.3f} ± {scale.deviation_sigma_t:.3f} t"
        text = f"batch {batch.name}: belt scale and known density disagree: {deviation}"
        values: dict[str, object] = {
            "batch": batch.name,
            "deviation": scale.deviation_t,
            "sigma": scale.deviation_sigma_t,
        }
        self._figures.control.events.add(_EVENT, name, text, now_ns, parameters=values)
        self._on_message(text)

    def _tell(self, trouble: str) -> None:
        if trouble != self._trouble:
            self._trouble = trouble
            self._on_message(trouble)
