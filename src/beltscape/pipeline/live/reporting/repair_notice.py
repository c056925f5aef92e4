"""Notice of repairs of the history: a warning at once, and a text for the alarm for some seconds."""

from __future__ import annotations

from time import monotonic

from beltscape.core.progress import Reporter
from beltscape.sinks.historian import Historian

HOLD_S = 10.0
"""Time for which a repair counts as present; its alarm then stays until it is acknowledged."""


class RepairNotice:
    """Watches the history for changes by other programs, which the history repairs."""

    def __init__(self, historian: Historian, reporter: Reporter) -> None:
        self._historian, self._reporter = historian, reporter
        self._message = ""
        self._since_s = float("-inf")

    def check(self) -> None:
        """Verify the history; it may wait for the disk."""
        self._historian.verify()
        message = self._historian.repair_message
        if message != self._message:
            self._message, self._since_s = message, monotonic()
            self._reporter.warn(message)

    @property
    def text(self) -> str:
        """Return the text of a repair of the last seconds; empty without one."""
        return self._message if monotonic() - self._since_s < HOLD_S else ""
