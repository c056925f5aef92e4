"""The historian: the belt ledger in SQLite, closed days as Parquet files.

`historian` is the entrance; `writing` is the only writer of the database, `reading` reads it, `archive` moves closed
days to files, and `storage` defines tables, files and connections.
"""

from beltscape.sinks.historian.historian import Historian, LedgerEnd
from beltscape.sinks.historian.reading.events import Event
from beltscape.sinks.historian.reading.periods import DaySum
from beltscape.sinks.historian.reading.series import Series

__all__ = ["DaySum", "Event", "Historian", "LedgerEnd", "Series"]
