"""Records on disk: the ledger of the belt in SQLite, closed days as Parquet."""

from beltscape.sinks.historian.historian import Historian, Resume
from beltscape.sinks.historian.reading.events import Event
from beltscape.sinks.historian.reading.periods import DaySum
from beltscape.sinks.historian.reading.series import Series

__all__ = ["DaySum", "Event", "Historian", "Resume", "Series"]
