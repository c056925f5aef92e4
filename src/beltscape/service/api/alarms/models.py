"""Response models of alarms: their state and their key figures."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from beltscape.alarms.management.priorities import Consequence, Response, get_rationale
from beltscape.alarms.management.statistics import AlarmStatistics
from beltscape.core.live.alarms import (
    Alarm,
    AlarmState,
    IsaState,
    Priority,
    Severity,
    Suppression,
    SuppressionKind,
)
from beltscape.core.live.translatable_message import get_key, get_values
from beltscape.files.documents.json_number import Number
from beltscape.service.api.common import ResponseModel


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
