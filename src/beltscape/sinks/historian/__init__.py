"""The historian: the belt ledger in SQLite, closed days as Parquet files.

`historian` is the entrance, `production_history` its part for production, `store` the only writer of the
database. By subject: `ledger` with `records`, `periods` of it, `findings`, `events`, `production`. `archive`
and `finding_days` move closed days to files (`day_files`). `database` opens and migrates; `recovery`
continues after damage.
"""

from beltscape.sinks.historian.events import Event, NewEvent
from beltscape.sinks.historian.findings import CheckKey, FindingSeries, StoredFinding
from beltscape.sinks.historian.historian import Historian, LedgerEnd
from beltscape.sinks.historian.periods import DaySum, Series

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
