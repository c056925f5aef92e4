"""The drift of the rig for the page: read beside the running plant; a proposal is taken over, or undone, at once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from beltscape.core.errors import BeltscapeError
from beltscape.core.progress import Reporter
from beltscape.pipeline.calibrating.drift import assess_drift, make_drift_document
from beltscape.pipeline.calibrating.rig_changes import RigChange, read_changes, take_proposal, undo_change
from beltscape.report.metrology.drift import render_drift
from beltscape.service.access import Access
from beltscape.service.project import open_project
from beltscape.service.reloader import Reload

Reloads = Callable[[str, str], Reload]
"""Takes over what changed in the project's files, for a user at an address."""


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

    def take(self, number: int, by: str, address: str) -> None:
        """Take the proposal of an estimate, and have the running plant measure with it from the next record on.

        Raises
        ------
        BeltscapeError
            With one line; then the former rig is in its place.
        """
        with self._lock:
            found = assess_drift(open_project(self._project), self._reporter)
            change = take_proposal(self._data, found, number, by)
            try:
                self._reload(by, address)
            except BeltscapeError:
                with suppress(BeltscapeError):  # the refusal is the error to report
                    undo_change(self._data, found.rig_path, by)
                raise
            self._audit(change, address)

    def undo(self, by: str, address: str) -> None:
        """Put the former rig back, and have the running plant measure with it. BeltscapeError with one line."""
        with self._lock:
            project = open_project(self._project)
            change = undo_change(self._data, project.resolve(project.settings.rig), by)
            self._audit(change, address)
            self._reload(by, address)

    def _audit(self, change: RigChange, address: str) -> None:
        detail: Mapping[str, str | int] = change.detail
        self._access.audit.write(f"rig {change.action}", change.by, address, detail)
