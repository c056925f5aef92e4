"""Reads project.toml again while the plant runs: the whole is checked first, then all that can change changes."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import time_ns

from beltscape.core.errors import BeltscapeError
from beltscape.core.progress import Reporter
from beltscape.pipeline.live.project import Project
from beltscape.pipeline.live.reporting.event_log import EventLog
from beltscape.service.changes.differences import Changed, compare, hash_contents, keep_values
from beltscape.service.changes.effects import CERTIFICATE, find_effect, is_of
from beltscape.service.changes.parts import PARTS, Change, RunningPlant
from beltscape.service.project import ProjectSettings, open_project

_AUDITED = 40
"""Most changes of one reload whose values are audited; the names of all are."""


@dataclass(frozen=True, slots=True)
class Reload:
    """The result of a reload."""

    at_once: tuple[Changed, ...]
    """Changes that hold now."""
    restart: tuple[Changed, ...]
    """Changes that need a restart; until then the old values hold."""


class SettingsReloader:
    """Applies a changed project.toml, and changed files that it names, to a running plant. Thread-safe."""

    def __init__(self, plant: RunningPlant, events: EventLog, reporter: Reporter) -> None:
        self._plant, self._audit, self._events, self._reporter = plant, plant.access.audit, events, reporter
        self._contents = hash_contents(plant.project)
        self._lock = threading.Lock()

    @property
    def settings(self) -> ProjectSettings:
        """The settings that hold now."""
        return self._plant.project.settings

    def reload(self, by: str, address: str = "") -> Reload:
        """Read and check the whole project again, then change what can change.

        Raises
        ------
        BeltscapeError
            One line that names the fault. The old settings stay then, all of them.
        """
        with self._lock:
            try:
                done = self._reload()
            except BeltscapeError as error:
                self._audit.write("settings refused", by, address, {"reason": str(error)})
                raise
            self._report(done, by, address)
            return done

    def find_changes(self) -> Reload:
        """Return what a reload would change now. InputError where it would be refused when reading the project."""
        with self._lock:
            return self._compare(*self._read())

    def _read(self) -> tuple[Project[ProjectSettings], dict[str, str]]:
        project = open_project(self._plant.project.path)
        return project, hash_contents(project)

    def _compare(self, project: Project[ProjectSettings], contents: Mapping[str, str]) -> Reload:
        present = self._plant.project.settings
        changes = list(compare(present, project.settings, self._contents, contents))
        has_tls = present.web.tls_certificate is not None, project.settings.web.tls_certificate is not None
        waiting = [
            one
            for one in changes
            if find_effect(one.key) == "restart" or (is_of(one.key, CERTIFICATE) and not all(has_tls))
        ]
        return Reload(tuple(one for one in changes if one not in waiting), tuple(waiting))

    def _reload(self) -> Reload:
        project, contents = self._read()
        found = self._compare(project, contents)
        waiting = {one.key for one in found.restart}
        settings = keep_values(project.settings, self._plant.project.settings, waiting)
        project = Project(project.path, settings)
        parts = [part for part in PARTS if any(is_of(one.key, part.tables) for one in found.at_once)]
        _apply([part.prepare(self._plant, project) for part in parts])
        self._plant.project = project
        kept = {key: self._contents[key] for key in waiting if key in self._contents}
        self._contents = {key: value for key, value in contents.items() if key not in waiting} | kept
        return found

    def _report(self, done: Reload, by: str, address: str) -> None:
        now, later = _join(done.at_once), _join(done.restart)
        values = {one.key: f"{one.before} → {one.after}" for one in done.at_once[:_AUDITED]}
        self._audit.write(
            "settings reloaded", by, address, values | ({"needs a restart": later} if later else {})
        )
        text = (f"changed: {now}" if now else "nothing changed") + (
            f"; a restart is needed for {later}" if later else ""
        )
        parameters = {"changed": now, "restart": later}
        self._events.add("settings", "reload", text, time_ns(), by, parameters)
        self._reporter.warn(f"settings read again: {text}")


def _apply(changes: Sequence[Change]) -> None:
    """Apply all changes; where one fails, revert it and those before it, and raise its error."""
    applied: list[Change] = []
    for change in changes:
        applied.append(change)
        try:
            change.apply()
        except BaseException:
            for one in reversed(applied):
                _revert(one.revert)
            raise


def _revert(revert: Callable[[], None]) -> None:
    with suppress(BeltscapeError):  # the error of the change itself is the one to report
        revert()


def _join(changes: Sequence[Changed]) -> str:
    return ", ".join(one.key for one in changes)
