"""Endpoints of the alarms: all of them, the journal, the key figures, and what people do to one."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from itertools import chain
from typing import Annotated

from fastapi import APIRouter, Depends, HTTPException, Query
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from beltscape.alarms.management.statistics import Annunciation, compute_statistics
from beltscape.core.errors import InputError
from beltscape.core.live.alarms import PRIORITIES, Priority
from beltscape.service.access import User, require_role
from beltscape.service.api.alarms.journal_csv import HEADER, format_journal_row
from beltscape.service.api.alarms.models import AlarmOut, StatisticsOut
from beltscape.service.api.common import AlarmName, AppContext, WallMs, check_period, describe_refusals
from beltscape.service.api.controls import Done
from beltscape.service.api.history import MS_NS, EventOut, RecordNumber, map_history_errors
from beltscape.sinks.historian import Event, Historian

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
        return StreamingResponse(chain([HEADER], rows), media_type="text/csv; charset=utf-8", headers=headers)


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
