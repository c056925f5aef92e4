"""Endpoints of the alarms: all of them, the journal, also as CSV, the key figures, and what people do to one."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from itertools import chain
from typing import Annotated

from fastapi import APIRouter, Depends, HTTPException, Query
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from beltscape.alarms.management import get_rationale
from beltscape.alarms.statistics import AlarmStatistics, Annunciation, compute_statistics
from beltscape.core.alarm_catalogue import Consequence, Response
from beltscape.core.alarms import (
    PRIORITIES,
    Alarm,
    AlarmState,
    IsaState,
    Priority,
    Severity,
    Suppression,
    SuppressionKind,
)
from beltscape.core.errors import InputError
from beltscape.core.translatable_message import get_key, get_values
from beltscape.files.json_number import Number
from beltscape.service.access import User, require_role
from beltscape.service.api.common import (
    AlarmName,
    AppContext,
    ResponseModel,
    WallMs,
    check_period,
    describe_refusals,
)
from beltscape.service.api.controls import Done
from beltscape.service.api.history import MS_NS, EventOut, RecordNumber, map_history_errors
from beltscape.sinks.historian import Event, Historian


class SuppressionOut(ResponseModel):
    """Why an alarm is not shown."""

    kind: SuppressionKind
    reason: Annotated[str, Field(description="A state of the plant, or what the person wrote")]
    by: str
    since_ms: int
    until_ms: Annotated[int | None, Field(description="When it ends by itself")]

    @classmethod
    def from_suppression(cls, suppression: Suppression) -> SuppressionOut:
        """Return the suppression with its times in ms."""
        until_ns = suppression.until_ns
        return cls(
            kind=suppression.kind,
            reason=suppression.reason,
            by=suppression.by,
            since_ms=suppression.since_ns // 1_000_000,
            until_ms=None if until_ns is None else until_ns // 1_000_000,
        )


class AlarmOut(ResponseModel):
    """The current state of one alarm."""

    name: str
    severity: Severity
    state: Annotated[AlarmState, Field(description="clear while it is suppressed")]
    value: Number
    limit: Number
    unit: str
    since_ms: Annotated[int | None, Field(description="System clock when it was raised")]
    detail: Annotated[str, Field(description="The fault and the fix, in English")]
    cause: Annotated[
        str, Field(description="Key of the fault among the alarm's, for translations; empty: none")
    ]
    values: Annotated[dict[str, float | int | str], Field(description="Values in the detail")]
    by: Annotated[str, Field(description="Who acknowledged it")]
    acknowledged_ms: Annotated[int | None, Field(description="System clock when it was acknowledged")]
    priority: Priority
    group: Annotated[str, Field(description="Group for first-out; empty: none")]
    first: Annotated[bool, Field(description="It came first in its group")]
    needs_reset: bool
    isa_state: Annotated[IsaState, Field(description="State by ANSI/ISA-18.2")]
    hidden_state: Annotated[AlarmState, Field(description="State that a suppressed alarm would have")]
    suppression: Annotated[SuppressionOut | None, Field(description="null: it is shown")]
    is_known: Annotated[bool, Field(description="false: what it rests on is not measured now")]
    consequences: Annotated[tuple[str, ...], Field(description="Alarms that it explains and hides")]
    consequence: Annotated[Consequence, Field(description="What the default priority expects if nobody acts")]
    response: Annotated[Response, Field(description="Time that it expects until then")]

    @classmethod
    def from_alarm(cls, alarm: Alarm) -> AlarmOut:
        """Return the alarm with its times in ms."""
        rationale, hidden = get_rationale(alarm.name), alarm.suppression
        return cls(
            name=alarm.name,
            severity=alarm.severity,
            state=alarm.state,
            value=alarm.value,
            limit=alarm.limit,
            unit=alarm.unit,
            since_ms=None if alarm.since_ns is None else alarm.since_ns // 1_000_000,
            detail=alarm.detail,
            cause=get_key(alarm.detail),
            values=get_values(alarm.detail),
            by=alarm.by,
            acknowledged_ms=None if alarm.acknowledged_ns is None else alarm.acknowledged_ns // 1_000_000,
            priority=alarm.priority,
            group=alarm.group,
            first=alarm.is_first,
            needs_reset=alarm.needs_reset,
            isa_state=alarm.isa_state,
            hidden_state=alarm.hidden_state,
            suppression=None if hidden is None else SuppressionOut.from_suppression(hidden),
            is_known=alarm.is_known,
            consequences=alarm.consequences,
            consequence=rationale.consequence,
            response=rationale.response,
        )


class FrequencyOut(ResponseModel):
    """Number of times that one alarm was raised."""

    name: str
    count: int
    share: Annotated[float, Field(description="Of all alarms, 0..1")]


class StatisticsOut(ResponseModel):
    """Key figures of the alarms of a period, as ANSI/ISA-18.2 monitors them."""

    count: Annotated[int, Field(description="Alarms raised and shown")]
    mean_per_10_min: Number
    peak_per_10_min: int
    last_10_min: int
    flood_share: Annotated[float, Field(description="Share of the time in floods: more than 10 in 10 min")]
    floods: int
    is_flood: Annotated[bool, Field(description="A flood goes on at the end of the period")]
    top: Annotated[tuple[FrequencyOut, ...], Field(description="The ten most frequent")]
    chattering: Annotated[tuple[str, ...], Field(description="Raised three times in a minute")]
    stale: Annotated[tuple[str, ...], Field(description="Standing for more than a day")]
    by_priority: dict[Priority, int]

    @classmethod
    def from_statistics(cls, found: AlarmStatistics) -> StatisticsOut:
        """Return the key figures."""
        return cls(
            count=found.count,
            mean_per_10_min=found.mean_per_10_min,
            peak_per_10_min=found.peak_per_10_min,
            last_10_min=found.last_10_min,
            flood_share=found.flood_share,
            floods=found.floods,
            is_flood=found.is_flood,
            top=tuple(FrequencyOut(name=one.name, count=one.count, share=one.share) for one in found.top),
            chattering=found.chattering,
            stale=found.stale,
            by_priority=dict(found.by_priority),
        )


_JOURNAL_COLUMNS = (
    "number", "time_utc", "alarm", "action", "state", "priority", "value", "limit", "unit", "suppression",
    "suppressed_by", "first", "group", "by", "text",
)  # fmt: skip
_FORMULA = ("=", "+", "-", "@")
"""Beginnings that a spreadsheet takes for a formula; people type reasons and names."""
_S_NS = 1_000_000_000
"""Nanoseconds of a second."""


def _format_row(values: list[str]) -> str:
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerow(values)
    return file.getvalue()


JOURNAL_HEADER = _format_row(list(_JOURNAL_COLUMNS))
"""First line of the table."""


def format_journal_row(event: Event) -> str:
    """Return the row of an entry, with its line end; an unknown value is empty."""
    parts: dict[str, object] = json.loads(event.parameters) if event.parameters else {}
    seconds, ns = divmod(event.wall_ns, _S_NS)
    time = datetime.fromtimestamp(seconds, UTC).replace(microsecond=ns // 1000)
    values: dict[str, object] = {
        **parts,
        "number": event.number,
        "time_utc": time.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
        "alarm": event.name,
        "by": event.by,
        "text": event.text,
    }
    return _format_row([_format_cell(values.get(column, "")) for column in _JOURNAL_COLUMNS])


def _format_cell(value: object) -> str:
    """Return a cell; a text that a spreadsheet would compute begins with an apostrophe."""
    if isinstance(value, bool):
        return "true" if value else "false"
    text = str(value)
    return f"'{text}" if isinstance(value, str) and text.startswith(_FORMULA) else text


_BATCH = 2000
"""Entries of the journal read at once; it bounds the memory."""
_LONGEST_MS = 366 * 86_400_000
"""Longest period of an export and of key figures: a leap year."""
Viewer = Annotated[User, Depends(require_role("viewer"))]
Operator = Annotated[User, Depends(require_role("operator"))]
Engineer = Annotated[User, Depends(require_role("engineer"))]
Reason = Annotated[str, Field(min_length=1, max_length=200, pattern=r"\S")]


class Shelve(BaseModel):
    """Why an alarm is shelved, and for how long."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    reason: Reason
    minutes: Annotated[float, Field(ge=1, le=10_080, allow_inf_nan=False)]


class TakeOutOfService(BaseModel):
    """Why an alarm is taken out of service."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    reason: Reason


def make_router(context: AppContext) -> APIRouter:
    """Return the routes below /api/alarms, except the acknowledgement."""
    router = APIRouter(prefix="/api/alarms", tags=["alarms"])
    _add_list(router, context)
    _add_journal(router, context.history)
    _add_statistics(router, context)
    _add_hiding(router, context)
    _add_showing(router, context)
    return router


def _add_list(router: APIRouter, context: AppContext) -> None:
    @router.get("", responses=describe_refusals())
    def alarms(_: Viewer) -> list[AlarmOut]:
        """All alarms, also those that are clear or suppressed."""
        return [AlarmOut.from_alarm(alarm) for alarm in context.live_state.take_snapshot().alarms]


def _add_journal(router: APIRouter, history: Historian) -> None:
    @router.get("/journal", responses=describe_refusals(503))
    def journal(
        _: Viewer,
        since_ms: WallMs,
        until_ms: WallMs,
        after: RecordNumber = 0,
        limit: Annotated[int, Query(ge=1, le=1000)] = 200,
        name: Annotated[str, Query(max_length=160, description="Of this alarm alone")] = "",
        newest: Annotated[bool, Query(description="The newest entries, the newest one first")] = False,
    ) -> list[EventOut]:
        """Entries of the alarm journal with numbers above ``after``, the oldest one first."""
        check_period(since_ms, until_ms)
        with map_history_errors():
            times_ns = since_ms * MS_NS, until_ms * MS_NS
            entries = history.alarm_journal(*times_ns, after, limit, name, newest=newest)
        return [EventOut.from_event(event) for event in entries]

    @router.get(
        "/journal.csv",
        response_class=StreamingResponse,
        responses=describe_refusals(503) | {200: {"content": {"text/csv": {}}, "description": "The journal"}},
    )
    def journal_csv(_: Viewer, since_ms: WallMs, until_ms: WallMs) -> StreamingResponse:
        """The alarm journal of at most a year."""
        _check_length(since_ms, until_ms)
        with map_history_errors():  # errors at the start give status 503 instead of a broken table
            history.alarm_journal(since_ms * MS_NS, until_ms * MS_NS, 0, 1)
        rows = (format_journal_row(event) for event in _read(history, since_ms, until_ms))
        headers = {"Content-Disposition": 'attachment; filename="beltscape_alarms.csv"'}
        return StreamingResponse(
            chain([JOURNAL_HEADER], rows), media_type="text/csv; charset=utf-8", headers=headers
        )


def _add_statistics(router: APIRouter, context: AppContext) -> None:
    @router.get("/statistics", responses=describe_refusals(503))
    def statistics(_: Viewer, since_ms: WallMs, until_ms: WallMs) -> StatisticsOut:
        """Key figures of the alarms of a period: rate, floods, chattering, the most frequent."""
        _check_length(since_ms, until_ms)
        with map_history_errors():
            entries = map(_make_annunciation, _read(context.history, since_ms, until_ms))
            raised = [one for one in entries if one is not None]
        present = context.live_state.take_snapshot().alarms
        return StatisticsOut.from_statistics(
            compute_statistics(raised, since_ms * MS_NS, until_ms * MS_NS, present)
        )


def _add_hiding(router: APIRouter, context: AppContext) -> None:
    controls = context.controls

    @router.post("/{name}/shelve", responses=describe_refusals(404, 409))
    def shelve_alarm(name: AlarmName, body: Shelve, user: Operator) -> Done:
        """Hide the alarm for a time; it is evaluated and journalled meanwhile."""
        alarms = controls.alarm_controls
        return _act(context, name, user, lambda: alarms.shelve(name, body.reason, body.minutes, user.name))

    @router.post("/{name}/out_of_service", responses=describe_refusals(404, 409))
    def take_alarm_out_of_service(name: AlarmName, body: TakeOutOfService, user: Engineer) -> Done:
        """Hide the alarm until it is returned to service."""
        alarms = controls.alarm_controls
        return _act(context, name, user, lambda: alarms.take_out_of_service(name, body.reason, user.name))


def _add_showing(router: APIRouter, context: AppContext) -> None:
    controls = context.controls

    @router.post("/{name}/unshelve", responses=describe_refusals(404, 409))
    def unshelve_alarm(name: AlarmName, user: Operator) -> Done:
        """End the shelving of the alarm before its time."""
        _require_kind(context, name, "shelved")
        return _act(context, name, user, lambda: controls.alarm_controls.return_to_service(name, user.name))

    @router.post("/{name}/return_to_service", responses=describe_refusals(404, 409))
    def return_alarm_to_service(name: AlarmName, user: Engineer) -> Done:
        """Show the alarm again that is out of service."""
        _require_kind(context, name, "out_of_service")
        return _act(context, name, user, lambda: controls.alarm_controls.return_to_service(name, user.name))

    @router.post("/{name}/reset", responses=describe_refusals(404, 409))
    def reset_alarm(name: AlarmName, user: Operator) -> Done:
        """Reset the alarm that has latched and is acknowledged."""
        return _act(context, name, user, lambda: controls.alarm_controls.reset(name, user.name))


def _act(context: AppContext, name: str, user: User, action: Callable[[], None]) -> Done:
    """Do something to an alarm; HTTPException 404 if there is none of that name, 409 with the reason if refused."""
    if all(alarm.name != name for alarm in context.live_state.take_snapshot().alarms):
        raise HTTPException(404, "there is no alarm of that name")
    try:
        action()
    except InputError as error:
        raise HTTPException(409, str(error)) from error
    return Done(by=user.name)


def _require_kind(context: AppContext, name: str, kind: str) -> None:
    """Raise HTTPException 409 where an alarm is not hidden, or in another way, which another role ends."""
    for alarm in context.live_state.take_snapshot().alarms:
        if alarm.name == name and (alarm.suppression is None or alarm.suppression.kind != kind):
            raise HTTPException(409, f"{name}: is not {kind.replace('_', ' ')}")


def _check_length(since_ms: int, until_ms: int) -> None:
    check_period(since_ms, until_ms)
    if until_ms - since_ms > _LONGEST_MS:
        detail = [
            {"loc": ["query", "until_ms"], "msg": "more than a year after since_ms", "type": "value_error"}
        ]
        raise HTTPException(422, detail)


def _read(history: Historian, since_ms: int, until_ms: int) -> Iterator[Event]:
    after = 0
    while events := history.alarm_journal(since_ms * MS_NS, until_ms * MS_NS, after, _BATCH):
        yield from events
        after = events[-1].number


def _make_annunciation(event: Event) -> Annunciation | None:
    """Return the annunciation of a journal's entry; None for other entries and for hidden alarms."""
    parts: dict[str, object] = json.loads(event.parameters) if event.parameters else {}
    if parts.get("state") != "raised" or "suppression" in parts:
        return None
    known: dict[str, Priority] = {one: one for one in PRIORITIES}
    priority = known.get(str(parts.get("priority")), "medium")
    return Annunciation(event.wall_ns, event.name, priority)
