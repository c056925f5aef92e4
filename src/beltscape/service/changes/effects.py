"""When a changed setting takes effect: at once in the running plant, or with its next start."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from beltscape.service.changes.differences import list_keys
from beltscape.service.project import ProjectSettings
from beltscape.service.protocols.serving import STARTERS

Effect = Literal["at once", "restart"]
MEASURING = ("rig", "empty", "belt", "matching", "flow", "density", "watch", "health")
"""Exchanged together between two records."""
CERTIFICATE = ("web.tls_certificate", "web.tls_key")
SINKS = ("history", "csv", "recording")
AT_ONCE = (
    *MEASURING,
    *SINKS,
    "queue",
    "alarms",
    "products",
    "production",
    "scale",
    "reports",
    "web",
    *STARTERS,
)
"""Keys and tables that a running plant takes over."""
RESTART = {
    "web.host": "the page's address is open",
    "web.port": "the page's port is open",
    "web.metrics_open": "the guard's public paths are fixed",
    "web.limits": "the limits belong to open connections",
    "history.reserve_mib": "the reserve lies on the disk",
    "history.day_begins_utc_h": "it must never be changed",
}
"""Exceptions from ``AT_ONCE``, with the reason."""


@dataclass(frozen=True, slots=True)
class SettingEffect:
    """A setting, and when a change of it takes effect."""

    key: str
    effect: Effect


def find_effect(key: str) -> Effect:
    """Return when a change of a setting, or of a whole table, takes effect."""
    if any(_is_within(key, one) for one in RESTART):
        return "restart"
    return "at once" if any(_is_within(key, one) for one in AT_ONCE) else "restart"


def list_effects() -> Iterator[SettingEffect]:
    """Yield every setting of project.toml with the effect of a change."""
    for key in list_keys(ProjectSettings):
        yield SettingEffect(key, find_effect(key))


def is_of(key: str, tables: tuple[str, ...]) -> bool:
    """Return whether a key belongs to one of the keys or tables."""
    return any(_is_within(key, one) for one in tables)


def _is_within(key: str, table: str) -> bool:
    return key == table or key.startswith(f"{table}.")
