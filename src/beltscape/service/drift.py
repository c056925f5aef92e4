"""The drift of the rig for the page: read beside the running plant; a proposal is taken over, or undone, at once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from beltscape.core.errors import BeltscapeError, InputError
from beltscape.core.progress import Reporter
from beltscape.pipeline.calibrating.drift import assess_drift, make_drift_document
from beltscape.pipeline.calibrating.rig_changes import (
    RigChange,
    read_changes,
    take_proposal,
    undo_change,
    withdraw_change,
)
from beltscape.report.metrology.drift import render_drift
from beltscape.service.access import Access
from beltscape.service.project import open_project
from beltscape.service.reloader import Reload

Reloads = Callable[[str, str], Reload]
"""Takes over the rig's file, for a user at an address; returns what else holds now."""


class ServedDrift:
    """The drift of a project's rig. Thread-safe."""

    def __init__(
        self, project: Path, data: Path, access: Access, reload: Reloads, reporter: Reporter
    ) -> None:
        """``data`` is the folder of the history; a change is in the audit log of ``access``."""
        self._project, self._data, self._access = project, data, access
        self._reload, self._reporter = reload, reporter
        self._lock = threading.Lock()

    def read(self) -> dict[str, Any]:
        """Return the drift as plain values. BeltscapeError where it cannot be read."""
        found = assess_drift(open_project(self._project), self._reporter)
        return {**make_drift_document(found), "changes": read_changes(self._data)}

    def render(self, language: str) -> str:
        """Return the page of the drift. BeltscapeError where it cannot be read, or the language is unknown."""
        zone = open_project(self._project).settings.production.time_zone
        return render_drift(self.read(), language, zone)

    def take(self, number: int, by: str, address: str) -> Sequence[str]:
        """Take the proposal of an estimate, and have the running plant measure with it from the next record on.

        Return the other settings whose files had to be read with it, and had changed.

        Raises
        ------
        BeltscapeError
            With one line; then the former rig is in its place.
        """
        with self._lock:
            found = assess_drift(open_project(self._project), self._reporter)
            change = take_proposal(self._data, found, number, by)
            return self._take_over(change, found.rig_path, address)

    def undo(self, by: str, address: str) -> Sequence[str]:
        """Put the former rig back, and have the running plant measure with it from the next record on.

        Return as `take`.

        Raises
        ------
        BeltscapeError
            With one line; then the taken rig is in its place.
        """
        with self._lock:
            project = open_project(self._project)
            rig_path = project.resolve(project.settings.rig)
            return self._take_over(undo_change(self._data, rig_path, by), rig_path, address)

    def _take_over(self, change: RigChange, rig_path: Path, address: str) -> Sequence[str]:
        """Reload and audit a change of the rig's file; withdraw it where the running plant refuses it."""
        try:
            done = self._reload(change.by, address)
        except BeltscapeError as error:
            try:
                withdraw_change(self._data, rig_path, change)
            except BeltscapeError as fault:
                raise InputError(f"{error}; {fault}") from fault
            raise InputError(f"{error}; the rig stays as it was") from error
        self._access.audit.write(f"rig {change.action}", change.by, address, change.detail)
        return [one.key for one in done.at_once if one.key != "rig"]
