"""The states of all alarms that outlive a restart: what is present, who acknowledged it and when, what came first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from beltscape.core.alarms import Severity
from beltscape.core.translatable_message import attach_key, get_key, get_values

PresentState = Literal["raised", "acknowledged", "gone", "latched"]
"""The states of an alarm that is present: all but "clear"."""
_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Time = Annotated[int, Field(ge=0, lt=2**63)]
"""System clock in ns; the bound is that of the history's database."""


@dataclass(frozen=True, slots=True)
class SavedText:
    """The text of an alarm with the parts from which a page composes it in another language."""

    text: str = ""
    key: str = ""
    values: Mapping[str, int | _Finite | str] = field(default_factory=dict[str, int | float | str])

    @classmethod
    def from_text(cls, text: str) -> SavedText:
        """Return the parts of a text."""
        return cls(str(text), get_key(text), get_values(text))

    def to_text(self) -> str:
        """Return the text; a `Message` where it has a key."""
        return attach_key(self.text, self.key, self.values)


@dataclass(frozen=True, slots=True)
class SavedAlarm:
    """One alarm that is present."""

    name: str
    state: PresentState
    """The state of its machine, also where it is hidden."""
    severity: Severity
    since_ns: _Time
    """System clock when it was raised."""
    by: str = ""
    """Name of the user that acknowledged it; empty: nobody yet."""
    acknowledged_ns: _Time | None = None
    """System clock when it was acknowledged; None: not yet."""
    value: _Finite | None = None
    """None: it has no number."""
    limit: _Finite | None = None
    unit: str = ""
    detail: SavedText = SavedText()
    state_of_plant: str = ""
    """The state of the plant that suppresses it; empty: none."""

    @property
    def status(self) -> tuple[object, ...]:
        """Return what a restart must not lose; value and text follow the readings."""
        return self.name, self.state, self.since_ns, self.by, self.acknowledged_ns, self.state_of_plant


@dataclass(frozen=True, slots=True)
class BoardSnapshot:
    """All alarms that are present at one moment."""

    alarms: tuple[SavedAlarm, ...] = ()
    """In the order in which their conditions began."""
    first: Mapping[str, str] = field(default_factory=dict[str, str])
    """Name of the alarm that came first, by group."""
    cameras: tuple[str, ...] = ()
    """The cameras of the run; an alarm of one that is gone is not restored."""

    @property
    def status(self) -> tuple[object, ...]:
        """Return what a restart must not lose."""
        return tuple(alarm.status for alarm in self.alarms), tuple(sorted(self.first.items())), self.cameras


_SNAPSHOT = TypeAdapter(BoardSnapshot)


def format_snapshot(snapshot: BoardSnapshot) -> bytes:
    """Return a snapshot as JSON."""
    return _SNAPSHOT.dump_json(snapshot, indent=1)


def parse_snapshot(text: bytes) -> BoardSnapshot:
    """Return the snapshot of a JSON document; ValueError where it is none."""
    return _SNAPSHOT.validate_json(text)
