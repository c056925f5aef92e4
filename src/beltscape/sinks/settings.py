"""Settings of the historian, the recorder and the CSV tables."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.quantities import DISK_SPACE

DayCount = Annotated[int, Field(ge=1, le=36500)]
"""A number of days, up to a century."""
Gib = Annotated[float, Field(gt=0), DISK_SPACE]
"""A size in GiB, up to a petabyte."""
GIB = 1 << 30
"""Bytes of a GiB."""


class HistorySettings(BaseModel):
    """Settings of ``[history]``: how much the historian keeps, and for how long. Totals are kept without limit."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    keep_sections: bool = True
    """If true, the cross-section of every record is kept."""
    database_days: DayCount = 7
    """Days in the database, counting those with records; older records are in day files only."""
    database_gib: Gib = 8.0
    """Largest size of the records in the database; above it the oldest move to day files earlier."""
    file_days: DayCount = 3650
    """Days in day files, counting those with records; older ones are removed with their sums by the minute."""
    file_gib: Gib = 200.0
    """Largest size of all day files; above it the oldest are removed."""
    events: Annotated[int, Field(ge=100, le=100_000_000)] = 1_000_000
    """Alarms and notes that are kept; above it the oldest are removed."""
    reserve_mib: Annotated[int, Field(ge=1, le=4096)] = 64
    """Reserved space in which records and totals, without sections, continue when the disk is full."""
    day_begins_utc_h: Annotated[float, Field(ge=-14, le=14, allow_inf_nan=False)] = 0.0
    """Hour of UTC at which a day begins: 5.0 for a shift that begins at 06:00 in UTC+1. It must never be changed."""


class RecordingSettings(BaseModel):
    """Settings of ``[recording]``: raw frame sets kept as captures."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    mode: Literal["off", "all", "ring"] = "ring"
    """off: nothing; all: everything; ring: the last minutes, kept permanently on an alarm or a person's request."""
    ring_min: Annotated[float, Field(gt=0, le=1440, allow_inf_nan=False)] = 2.0
    """Length of the ring."""
    capture_min: Annotated[float, Field(gt=0, le=1440, allow_inf_nan=False)] = 10.0
    """Length of one capture if everything is recorded."""
    image: Literal["tiff", "png"] = "tiff"
    """tiff: uncompressed and fast; png: a third smaller, with sixty times the computation."""
    limit_gib: Gib = 50.0
    """Largest size of all recordings including the ring; the oldest that are not kept are removed."""
    free_gib: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)] = 4.0
    """Recording pauses while the disk has less free space, which is left to the records."""
    queue: Annotated[int, Field(ge=1, le=1000)] = 16
    """Longest queue of frame sets to be written; beyond it they are skipped and counted."""


class CsvSettings(BaseModel):
    """Settings of ``[csv]``: records as CSV, one file per day."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    enabled: bool = False
    """If true, the tables are written."""
    days: DayCount = 365
    """Number of files that are kept, one for each day with records; above it the oldest are removed."""
    day_begins_utc_h: Annotated[float, Field(ge=-14, le=14, allow_inf_nan=False)] = 0.0
    """Hour of UTC at which a day begins."""
