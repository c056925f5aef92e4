"""Endpoints of the history: series, records, events, days and cross-sections of any period."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Generator
from contextlib import contextmanager
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends, HTTPException, Query
from numpy.typing import NDArray
from pydantic import Field

from beltscape.core.errors import BeltscapeError
from beltscape.core.ledger import BeltRecord, Standing
from beltscape.files.json_number import Number
from beltscape.service.access import User, require_role
from beltscape.service.api.common import AppContext, ResponseModel, WallMs, check_period, describe_refusals
from beltscape.sinks.historian import DaySum, Event, Historian, Series

MS_NS = 1_000_000
"""Nanoseconds of a millisecond."""
Viewer = Annotated[User, Depends(require_role("viewer"))]
RecordNumber = Annotated[int, Query(ge=0, le=2**53, description="Number of an entry of the ledger")]


class SeriesOut(ResponseModel):
    """Curves over equal intervals; null: not known."""

    start_ms: Annotated[tuple[int, ...], Field(description="System clock at which each interval begins")]
    width_ms: float
    flow_m3_h: tuple[Number, ...]
    low_m3_h: tuple[Number, ...]
    high_m3_h: tuple[Number, ...]
    mass_flow_t_h: tuple[Number, ...]
    speed_m_s: tuple[Number, ...]
    coverage: tuple[Number, ...]
    volume_m3: tuple[Number, ...]
    mass_t: tuple[Number, ...]
    valid_m: tuple[Number, ...]
    degraded_m: tuple[Number, ...]
    missing_m: tuple[Number, ...]

    @classmethod
    def from_series(cls, curves: Series) -> SeriesOut:
        """Return the curves in ms, m³/h, m/s, m³, t and m."""
        return cls(
            start_ms=tuple(int(ns) // MS_NS for ns in curves.start_ns),
            width_ms=curves.width_ns / MS_NS,
            flow_m3_h=_to_json_numbers(curves.flow_m3_h),
            low_m3_h=_to_json_numbers(curves.flow_low_m3_h),
            high_m3_h=_to_json_numbers(curves.flow_high_m3_h),
            mass_flow_t_h=_to_json_numbers(curves.mass_flow_t_h),
            speed_m_s=_to_json_numbers(curves.speed_mm_s * 1e-3),
            coverage=_to_json_numbers(curves.coverage),
            volume_m3=_to_json_numbers(curves.volume_mm3 * 1e-9),
            mass_t=_to_json_numbers(curves.mass_kg * 1e-3),
            valid_m=_to_json_numbers(curves.valid_mm * 1e-3),
            degraded_m=_to_json_numbers(curves.degraded_mm * 1e-3),
            missing_m=_to_json_numbers(curves.missing_mm * 1e-3),
        )


class RecordOut(ResponseModel):
    """One entry of the ledger."""

    number: int
    run: int
    wall_ms: int
    from_m: float
    to_m: float
    standing: Standing
    reason: str
    volume_m3: Number
    sigma_m3: Number
    mass_t: Number
    flow_m3_h: Number
    coverage: Number
    cameras: int

    @classmethod
    def from_record(cls, record: BeltRecord) -> RecordOut:
        """Return the record in m³, t and m."""
        strip = record.strip
        return cls(
            number=record.number,
            run=record.run,
            wall_ms=record.wall_ns // MS_NS,
            from_m=record.belt_mm[0] * 1e-3,
            to_m=record.belt_mm[1] * 1e-3,
            standing=record.standing,
            reason=record.reason,
            volume_m3=record.volume_mm3 * 1e-9,
            sigma_m3=record.sigma_mm3 * 1e-9,
            mass_t=record.mass_kg * 1e-3,
            flow_m3_h=None if strip is None else strip.volume_flow_m3_h,
            coverage=None if strip is None else strip.coverage,
            cameras=record.cameras,
        )


class DayOut(ResponseModel):
    """Sums of one day."""

    day: Annotated[str, Field(description="Such as 2026-11-21")]
    records: int
    volume_m3: Number
    mass_t: Number
    valid_m: float
    degraded_m: float
    missing_m: float

    @classmethod
    def from_day(cls, day: DaySum) -> DayOut:
        """Return the day in m³, t and m."""
        return cls(
            day=day.day,
            records=day.records,
            volume_m3=day.volume_mm3 * 1e-9,
            mass_t=day.mass_kg * 1e-3,
            valid_m=day.valid_mm * 1e-3,
            degraded_m=day.degraded_mm * 1e-3,
            missing_m=day.missing_mm * 1e-3,
        )


class EventOut(ResponseModel):
    """One event of the history."""

    number: int
    wall_ms: int
    kind: str
    name: str
    text: Annotated[str, Field(description="In English")]
    by: str
    parameters: Annotated[
        dict[str, object], Field(description="The parts of the text, for pages in other languages")
    ]

    @classmethod
    def from_event(cls, event: Event) -> EventOut:
        """Return the event with its time in ms."""
        return cls(
            number=event.number,
            wall_ms=event.wall_ns // MS_NS,
            kind=event.kind,
            name=event.name,
            text=event.text,
            by=event.by,
            parameters=json.loads(event.parameters) if event.parameters else {},
        )


class SectionOut(ResponseModel):
    """The mean cross-section of a record."""

    number: int
    x_mm: tuple[float, ...]
    height_mm: tuple[Number, ...]


@contextmanager
def map_history_errors() -> Generator[None]:
    """Turn errors of reading the history into HTTPException 503."""
    try:
        yield
    except (sqlite3.Error, OSError, BeltscapeError) as error:
        raise HTTPException(503, "the history cannot be read at the moment; see the alarms") from error


def make_router(context: AppContext) -> APIRouter:
    """Return the routes GET /api/series, /api/records, /api/events, /api/days and /api/section."""
    router = APIRouter(prefix="/api", tags=["history"])
    _add_series(router, context.history)
    _add_records(router, context.history)
    _add_events(router, context.history)
    _add_days(router, context.history)
    _add_section(router, context.history)
    return router


def _add_series(router: APIRouter, history: Historian) -> None:
    @router.get("/series", responses=describe_refusals(503))
    def series(
        _: Viewer, since_ms: WallMs, until_ms: WallMs, points: Annotated[int, Query(ge=2, le=2000)] = 600
    ) -> SeriesOut:
        """Curves from ``since_ms`` to before ``until_ms`` in at most ``points`` intervals."""
        check_period(since_ms, until_ms)
        with map_history_errors():
            curves = history.series(since_ms * MS_NS, until_ms * MS_NS, points)
        return SeriesOut.from_series(curves)


def _add_records(router: APIRouter, history: Historian) -> None:
    @router.get("/records", responses=describe_refusals(503))
    def records(
        _: Viewer,
        since_ms: WallMs,
        until_ms: WallMs,
        limit: Annotated[int, Query(ge=1, le=1000)] = 200,
        after: RecordNumber = 0,
    ) -> list[RecordOut]:
        """Entries of the ledger with numbers above ``after``, in order."""
        check_period(since_ms, until_ms)
        with map_history_errors():
            entries = history.records(since_ms * MS_NS, until_ms * MS_NS, limit, after)
        return [RecordOut.from_record(record) for record in entries]


def _add_events(router: APIRouter, history: Historian) -> None:
    @router.get("/events", responses=describe_refusals(503))
    def events(
        _: Viewer, since_ms: WallMs, until_ms: WallMs, limit: Annotated[int, Query(ge=1, le=1000)] = 200
    ) -> list[EventOut]:
        """Alarms, messages and operators' actions, newest first."""
        check_period(since_ms, until_ms)
        with map_history_errors():
            entries = history.events(since_ms * MS_NS, until_ms * MS_NS, limit)
        return [EventOut.from_event(event) for event in entries]


def _add_days(router: APIRouter, history: Historian) -> None:
    @router.get("/days", responses=describe_refusals(503))
    def days(_: Viewer, since_ms: WallMs, until_ms: WallMs) -> list[DayOut]:
        """Sums of at most the last 1000 days that begin in that period, oldest first."""
        check_period(since_ms, until_ms)
        with map_history_errors():
            totals = history.day_totals(since_ms * MS_NS, until_ms * MS_NS)[-1000:]
        return [DayOut.from_day(day) for day in totals]


def _add_section(router: APIRouter, history: Historian) -> None:
    @router.get("/section", responses=describe_refusals(404, 503))
    def section(_: Viewer, number: RecordNumber) -> SectionOut:
        """The cross-section of the record of that number."""
        with map_history_errors():
            cross_section = history.section(number)
        if cross_section is None:
            raise HTTPException(404, "no cross-section is kept for that record")
        return SectionOut(
            number=number,
            x_mm=_round(cross_section.x_mm),
            height_mm=_to_json_numbers(cross_section.height_mm),
        )


def _round(values: NDArray[np.floating]) -> tuple[float, ...]:
    return tuple(round(float(value), 3) for value in values)


def _to_json_numbers(values: NDArray[np.floating]) -> tuple[float | None, ...]:
    """Return the values with six significant digits, None where not finite."""
    return tuple(float(f"{value:.6g}") if np.isfinite(value) else None for value in values)
