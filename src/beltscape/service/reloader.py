"""Reads project.toml again while the plant runs: the whole is checked first, then all that can change changes.

Each part of the running plant that takes other settings first prepares its change. A part of another package joins
by an entry in ``PARTS``.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import time_ns

from beltscape.core.errors import BeltscapeError
from beltscape.core.progress import Reporter
from beltscape.pipeline.live.assembly import AssembledRun
from beltscape.pipeline.live.engine_components import MeasuringParts
from beltscape.pipeline.live.event_log import EventLog
from beltscape.pipeline.live.measuring_parts import make_measuring_parts, read_run_rig, require_same_cameras
from beltscape.pipeline.live.project import Project, read_alarm_texts
from beltscape.protocols.plant import Provenance
from beltscape.service.access import Access
from beltscape.service.changes import (
    CERTIFICATE,
    MEASURING,
    SINKS,
    Changed,
    compare,
    find_effect,
    hash_contents,
    is_of,
    keep_values,
)
from beltscape.service.hosting import RunningServer
from beltscape.service.live_state import LiveState
from beltscape.service.production.belt_scale import check_scale
from beltscape.service.production.reports import check_reports_and_printer
from beltscape.service.production.serving import ServedProduction, name_plant
from beltscape.service.project import ProjectSettings, open_project
from beltscape.service.protocol_checks import CHECKS
from beltscape.service.protocols import STARTERS, ServedPlant, ServedProtocols, describe_provenance
from beltscape.service.settings import WebSettings
from beltscape.service.tls import CertificateExpiry


@dataclass(slots=True)
class RunningPlant:
    """Parts of the running plant that a change may exchange; fields that are None are not served."""

    project: Project[ProjectSettings]
    assembled: AssembledRun
    parts: MeasuringParts
    """Those in use, or about to be."""
    live_state: LiveState
    access: Access
    expiry: CertificateExpiry
    served: ServedPlant
    production: ServedProduction
    server: RunningServer | None = None
    protocols: ServedProtocols | None = None


@dataclass(frozen=True, slots=True)
class CheckedChange:
    """A change that is checked and ready."""

    apply: Callable[[], None]
    revert: Callable[[], None]
    """Restores what was, also after ``apply`` has failed."""


Prepare = Callable[[RunningPlant, Project[ProjectSettings]], CheckedChange]
"""Checks and loads all that a change needs; raises a BeltscapeError with one line where it cannot be."""


@dataclass(frozen=True, slots=True)
class ReloadablePart:
    """A part that takes over the settings of some tables."""

    tables: tuple[str, ...]
    """Keys or tables of project.toml."""
    prepare: Prepare


def _prepare_measuring(plant: RunningPlant, project: Project[ProjectSettings]) -> CheckedChange:
    reporter, data = plant.assembled.components.reporter, project.resolve(project.settings.data)
    rig = read_run_rig(project, reporter)
    require_same_cameras(project, rig, plant.parts.rig)
    workers = plant.assembled.components.workers
    before, after = plant.parts, make_measuring_parts(project, rig, reporter, data, workers)
    described = plant.served.provenance, describe_provenance(project)

    def exchange(parts: MeasuringParts, provenance: Provenance) -> None:
        plant.assembled.engine.exchange(parts)
        plant.parts, plant.served.provenance = parts, provenance

    return CheckedChange(lambda: exchange(after, described[1]), lambda: exchange(before, described[0]))


def _prepare_alarms(plant: RunningPlant, project: Project[ProjectSettings]) -> CheckedChange:
    board, texts = plant.assembled.components.board, read_alarm_texts(project)
    before, texts_before = board.settings, board.texts
    return CheckedChange(
        lambda: board.set_settings(project.settings.alarms, texts),
        lambda: board.set_settings(before, texts_before),
    )


def _prepare_sinks(plant: RunningPlant, project: Project[ProjectSettings]) -> CheckedChange:
    assembled, before = plant.assembled, plant.project.settings
    exchange, restore = (assembled.table.prepare(one.csv) for one in (project.settings, before))

    def use(settings: ProjectSettings, exchange_table: Callable[[], None]) -> None:
        exchange_table()
        assembled.historian.set_settings(settings.history)
        if assembled.components.recorder is not None:
            assembled.components.recorder.set_settings(settings.recording)

    return CheckedChange(lambda: use(project.settings, exchange), lambda: use(before, restore))


def _prepare_queue(plant: RunningPlant, project: Project[ProjectSettings]) -> CheckedChange:
    queue, before = plant.assembled.components.queue, plant.project.settings.queue.frames
    frames = project.settings.queue.frames
    return CheckedChange(lambda: queue.set_capacity(frames), lambda: queue.set_capacity(before))


def _prepare_production(plant: RunningPlant, project: Project[ProjectSettings]) -> CheckedChange:
    control, before, after = plant.assembled.production, plant.project.settings, project.settings
    control.require_present(after.products)
    return CheckedChange(
        lambda: control.set_settings(after.products, after.production),
        lambda: control.set_settings(before.products, before.production),
    )


def _prepare_scale(plant: RunningPlant, project: Project[ProjectSettings]) -> CheckedChange:
    production, before, after = plant.production, plant.project.settings.scale, project.settings.scale
    if after is not None:
        check_scale(after)
    return CheckedChange(lambda: production.exchange_scale(after), lambda: production.exchange_scale(before))


def _prepare_reports(plant: RunningPlant, project: Project[ProjectSettings]) -> CheckedChange:
    production, before, after = plant.production, plant.project.settings, project.settings
    if after.reports is not None:
        check_reports_and_printer(after.reports, after.production.time_zone)
    return CheckedChange(
        lambda: production.exchange_reports(after.reports, name_plant(after)),
        lambda: production.exchange_reports(before.reports, name_plant(before)),
    )


def _prepare_page(plant: RunningPlant, project: Project[ProjectSettings]) -> CheckedChange:
    def use(settings: ProjectSettings) -> None:
        plant.live_state.set_settings(settings.web)
        plant.access.set_settings(settings.web.access)

    return CheckedChange(lambda: use(project.settings), lambda: use(plant.project.settings))


def _prepare_certificate(plant: RunningPlant, project: Project[ProjectSettings]) -> CheckedChange:
    web = project.settings.web
    expiry, expiry_before = plant.expiry.read(web.tls_certificate, web.tls_key), plant.expiry.expiry_s
    server = plant.server

    def use(one: WebSettings, expiry_s: float) -> None:
        if server is not None and one.tls_certificate and one.tls_key:
            server.exchange_certificate(one.tls_certificate, one.tls_key)
        plant.expiry.expiry_s = expiry_s

    return CheckedChange(lambda: use(web, expiry), lambda: use(plant.project.settings.web, expiry_before))


def _prepare_protocol(name: str) -> Prepare:
    def prepare(plant: RunningPlant, project: Project[ProjectSettings]) -> CheckedChange:
        settings, before = getattr(project.settings, name), getattr(plant.project.settings, name)
        if settings is not None:
            CHECKS[name](settings)
        protocols = plant.protocols
        if protocols is None:
            return CheckedChange(lambda: None, lambda: None)
        return CheckedChange(
            lambda: protocols.exchange(name, settings), lambda: protocols.exchange(name, before)
        )

    return prepare


PARTS: tuple[ReloadablePart, ...] = (
    *(ReloadablePart((name,), _prepare_protocol(name)) for name in STARTERS),
    ReloadablePart(CERTIFICATE, _prepare_certificate),
    ReloadablePart(MEASURING, _prepare_measuring),
    ReloadablePart(SINKS, _prepare_sinks),
    ReloadablePart(("queue",), _prepare_queue),
    ReloadablePart(("alarms",), _prepare_alarms),
    ReloadablePart(("products", "production"), _prepare_production),
    ReloadablePart(("scale",), _prepare_scale),
    ReloadablePart(("reports", "web.plant"), _prepare_reports),
    ReloadablePart(("web",), _prepare_page),
)
"""In the order in which they change: first what may still fail, as a port that another program holds."""

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
        return self._reload_and_report(lambda found: found, by, address)

    def reload_rig(self, by: str, address: str = "") -> Reload:
        """Take over the rig's file alone; other settings that differ wait for `reload`.

        Files that belong to the measurement, such as the empty belt, are read with the rig: where their content has
        changed, it holds, too, and the result names them.

        Raises
        ------
        BeltscapeError
            One line that names the fault. The old rig stays then.
        """
        return self._reload_and_report(
            lambda found: Reload(tuple(one for one in found.at_once if self._is_of_rig(one)), ()), by, address
        )

    def _is_of_rig(self, one: Changed) -> bool:
        return one.key == "rig" or (is_of(one.key, MEASURING) and one.is_content)

    def _reload_and_report(self, choose: Callable[[Reload], Reload], by: str, address: str) -> Reload:
        with self._lock:
            try:
                done = self._reload(choose)
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

    def _reload(self, choose: Callable[[Reload], Reload]) -> Reload:
        project, contents = self._read()
        compared = self._compare(project, contents)
        found = choose(compared)
        waiting = {one.key for one in (*compared.at_once, *compared.restart) if one not in found.at_once}
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


def _apply(changes: Sequence[CheckedChange]) -> None:
    """Apply all changes; where one fails, revert it and those before it, and raise its error."""
    applied: list[CheckedChange] = []
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
