"""What may be told to the historian, the recorder and the CSV table."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

DayCount = Annotated[int, Field(ge=1, le=36500)]
Gib = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]


class HistorySettings(BaseModel):
    """The historian: how much it keeps, and for how long. Totals are kept for ever."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    keep_sections: bool = True
    """Whether the cross-section behind every record is kept."""
    database_days: DayCount = 7
    """Days in the database, counting those on which something passed; older records lie in day files only."""
    database_gib: Gib = 8.0
    """What the records in the database may take; above it the oldest go to the day files earlier."""
    file_days: DayCount = 3650
    """Days in day files, counted the same way; older ones and their sums by the minute go, sums by the hour stay."""
    file_gib: Gib = 200.0
    """What all day files may take; above it the oldest are removed."""
    events: Annotated[int, Field(ge=100, le=100_000_000)] = 1_000_000
    """Alarms and notes that are kept; above it the oldest are removed."""
    reserve_mib: Annotated[int, Field(ge=1, le=4096)] = 64
    """Space held back for the day the disk is full: records and totals go on in it, without sections."""
    day_begins_utc_h: Annotated[float, Field(ge=-14, le=14, allow_inf_nan=False)] = 0.0
    """Hour of UTC at which a day begins: 5.0 for a shift that begins at 06:00 in UTC+1. Never to be changed."""


class RecordingSettings(BaseModel):
    """Raw frame sets, kept as captures."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    mode: Literal["off", "all", "ring"] = "ring"
    """off: nothing; all: everything; ring: the last minutes, kept for good when an alarm or a person asks."""
    ring_min: Annotated[float, Field(gt=0, le=1440, allow_inf_nan=False)] = 2.0
    """How far the ring reaches back."""
    capture_min: Annotated[float, Field(gt=0, le=1440, allow_inf_nan=False)] = 10.0
    """How much goes into one capture where everything is recorded."""
    image: Literal["tiff", "png"] = "tiff"
    """tiff: uncompressed, next to no work; png: a third smaller, sixty times the work."""
    limit_gib: Gib = 50.0
    """What recordings may take with the ring; the oldest that nobody asked to keep are removed."""
    free_gib: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)] = 4.0
    """Recording pauses while the disk has less than that free: the records need it more."""
    queue: Annotated[int, Field(ge=1, le=1000)] = 16
    """Frame sets that may wait to be written; beyond it they are left out and counted."""


class CsvSettings(BaseModel):
    """Records as CSV, a file a day."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    enabled: bool = False
    """Whether it is written."""
    days: DayCount = 365
    """Files that are kept, one for each day on which something passed; above it the oldest are removed."""
    day_begins_utc_h: Annotated[float, Field(ge=-14, le=14, allow_inf_nan=False)] = 0.0
    """Hour of UTC at which a day begins."""
