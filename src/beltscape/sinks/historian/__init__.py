"""The historian: the belt ledger in SQLite, closed days as Parquet files.

`historian` is the entrance; `writing` is the only writer of the database, `reading` reads it, `archive` moves closed
days to files, and `storage` defines tables, files and connections.
"""

from beltscape.sinks.historian.historian import Historian, LedgerEnd
from beltscape.sinks.historian.reading.events import Event, NewEvent
from beltscape.sinks.historian.reading.findings import CheckKey, FindingSeries
from beltscape.sinks.historian.reading.periods import DaySum
from beltscape.sinks.historian.reading.series import Series
from beltscape.sinks.historian.storage.finding_rows import StoredFinding

__all__ = [
    "CheckKey",
    "DaySum",
    "Event",
    "FindingSeries",
    "Historian",
    "LedgerEnd",
    "NewEvent",
    "Series",
    "StoredFinding",
]
