"""Records on disk: the ledger of the belt in SQLite, closed days as Parquet."""

from beltscape.sinks.historian.events import Event
from beltscape.sinks.historian.historian import Historian, Resume
from beltscape.sinks.historian.past import DaySum
from beltscape.sinks.historian.series import Series

__all__ = ["DaySum", "Event", "Historian", "Resume", "Series"]
