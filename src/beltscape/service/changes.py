"""Changes of a project's settings as single keys: what differs, and when it takes effect.

Values are compared, and the files that they name. A change takes effect at once in the running plant, or with its
next start.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel

from beltscape.core.errors import InputError
from beltscape.files.json_text import hash_file
from beltscape.pipeline.live.project import Project, RunSettings
from beltscape.pipeline.measuring.belt import hash_empty_belt
from beltscape.service.project import ProjectSettings
from beltscape.service.protocols import STARTERS

Model = TypeVar("Model", bound=BaseModel)
_LONGEST_VALUE = 80
"""Characters of a value in an answer: a line of a terminal."""
_LARGEST_BYTES = 64 << 20
"""Larger files are no settings and are not read."""
NO_SETTINGS = frozenset({"data", "capture.folder", "encoder.path", "scale.csv", "reports.folder"})
"""Keys of folders and of growing files, whose content is no setting."""
_EMPTY_BELT = "empty"
"""The key of the empty belt, which may be a folder."""


@dataclass(frozen=True, slots=True)
class Changed:
    """A setting that differs."""

    key: str
    """Such as "alarms.overload.mass_flow_t_h"."""
    before: str
    after: str
    is_content: bool = False
    """True where the setting is the same, and the file that it names has another content."""


def list_keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Yield the keys of all settings of a model, those of its tables with the table's name and a dot before them."""
    for name, field in model.model_fields.items():
        table = _find_table(field.annotation)
        if table is None:
            yield prefix + name
        else:
            yield from list_keys(table, f"{prefix}{name}.")


def compare(
    before: BaseModel,
    after: BaseModel,
    contents_before: Mapping[str, str],
    contents_after: Mapping[str, str],
    prefix: str = "",
) -> Iterator[Changed]:
    """Yield the settings that differ, also where only the content of the file that one names differs."""
    for name in type(before).model_fields:
        key, old, new = prefix + name, getattr(before, name), getattr(after, name)
        if isinstance(old, BaseModel) and isinstance(new, BaseModel):
            yield from compare(old, new, contents_before, contents_after, f"{key}.")
        elif old != new:
            yield Changed(key, _describe(key, old), _describe(key, new))
        elif contents_before.get(key) != contents_after.get(key):
            shorts = [
                contents.get(key, "")[:8] or "no file" for contents in (contents_before, contents_after)
            ]
            yield Changed(key, f"{old} ({shorts[0]})", f"{new} ({shorts[1]})", is_content=True)


def hash_contents(project: Project[RunSettings]) -> dict[str, str]:
    """Return the SHA-256 of the files that settings name, by the key; InputError if one cannot be read."""
    contents: dict[str, str] = {}
    for key, value in list_values(project.settings):
        if not isinstance(value, Path) or key in NO_SETTINGS:
            continue
        path = project.resolve(value)
        try:
            if key == _EMPTY_BELT:
                contents[key] = hash_empty_belt(path)
            elif path.is_file() and path.stat().st_size <= _LARGEST_BYTES:
                contents[key] = hash_file(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error}); {key} names it") from error
    return contents


def keep_values(settings: Model, present: Model, keys: set[str], prefix: str = "") -> Model:
    """Return the settings with the present values of some keys."""
    update: dict[str, object] = {}
    for name in type(settings).model_fields:  # pyrefly: ignore[missing-attribute]
        key, old, new = prefix + name, getattr(present, name), getattr(settings, name)
        if key in keys:
            update[name] = old
        elif isinstance(old, BaseModel) and isinstance(new, BaseModel):
            update[name] = keep_values(new, old, keys, f"{key}.")
    return settings.model_copy(update=update)


def list_values(settings: BaseModel, prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield the key and the value of every setting."""
    for name in type(settings).model_fields:
        value = getattr(settings, name)
        if isinstance(value, BaseModel):
            yield from list_values(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _find_table(annotation: Any) -> type[BaseModel] | None:
    """Return the model of a setting that is a table, also of one that may be absent."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if get_origin(annotation) in (Union, UnionType):
        return next((table for part in get_args(annotation) if (table := _find_table(part))), None)
    return None


def _describe(key: str, value: object) -> str:
    if value is None:
        return "not given"
    if isinstance(value, BaseModel):
        return "given"
    if "password" in key and not isinstance(value, Path):
        return "…"
    text = str(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[: _LONGEST_VALUE - 1]}…"


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
    "matching.workers": "the worker processes run",
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
