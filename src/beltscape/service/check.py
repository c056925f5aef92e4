"""The checks of a project: those that a run begins with, and `beltscape run --check`, which makes all of them."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from typing import Any

from beltscape.core.errors import BeltscapeError, SettingsError
from beltscape.core.progress import Reporter
from beltscape.pipeline.live.check import Check, is_running, list_checks
from beltscape.pipeline.live.project import Project
from beltscape.service.access.database import FILE, Database
from beltscape.service.hosting import bind_socket, check_listening
from beltscape.service.production.belt_scale import check_scale
from beltscape.service.production.mail import find_mail_fault
from beltscape.service.production.printing import check_printer
from beltscape.service.production.reports import check_reports
from beltscape.service.project import ProjectSettings
from beltscape.service.protocol_checks import CHECKS, REACHES

_LISTENING = ("web", "modbus", "opcua")
"""Tables of servers that listen at a TCP port."""
_PATIENCE_S = 3.0
"""Time for another machine to accept a connection. Chosen: one of the plant's network answers in milliseconds."""


def check_plant(project: Project[ProjectSettings], reporter: Reporter, *, page: bool) -> dict[str, str]:
    """Return one line for each part that a run would open; warn of other machines that do not answer now.

    Raises
    ------
    BeltscapeError
        The first fault that would end the run, with the names of the other parts that have one.
    """
    lines: dict[str, str] = {}
    faults: dict[str, BeltscapeError] = {}
    checks = [
        *list_checks(project, reporter),
        *list_start_checks(project, page=page),
        *_list_others(project, page),
    ]
    for name, check in checks:
        try:
            lines[name] = check()
        except BeltscapeError as error:
            if all(str(error) != str(other) for other in faults.values()):  # three parts read the same rig
                faults[name] = error
        reporter.step("checking", len(lines) + len(faults), len(checks))
    if faults:
        first, *others = faults.items()
        more = f"; further faults in {', '.join(name for name, _ in others)}" if others else ""
        raise type(first[1])(f"{first[1]}{more}") from first[1]
    for name, reach in _list_reaches(project):
        if trouble := reach():
            lines[name] += f"; not reached: {trouble}"
            reporter.warn(f"{name}: not reached now: {trouble}; a run goes on trying")
    return lines


def check_start(project: Project[ProjectSettings], *, page: bool) -> None:
    """Raise the first fault of what a run serves beside the measurement, before it opens its history."""
    for _, check in list_start_checks(project, page=page):
        check()


def list_start_checks(project: Project[ProjectSettings], *, page: bool) -> Iterator[Check]:
    """Yield the checks of what a run serves beside the measurement: page, reports, scale and protocols."""
    settings = project.settings
    tables = [name for name in _LISTENING if (page or name != "web") and getattr(settings, name) is not None]
    if page:
        yield "page", lambda: _page_line(project)
    if (reports := settings.reports) is not None:
        yield "reports", lambda: check_reports(reports, settings.production.time_zone)
    if (scale := settings.scale) is not None:
        yield "scale", lambda: check_scale(scale)
    for table, check_protocol in CHECKS.items():
        own = getattr(settings, table)
        if own is not None:
            earlier = tables[: tables.index(table)] if table in tables else None
            yield table, partial(_check_protocol, project, table, earlier, check_protocol)


def _list_others(project: Project[ProjectSettings], page: bool) -> Iterator[Check]:
    """Yield the checks of what a run starts without, and with an alarm: its users and its printer."""
    reports = project.settings.reports
    if page:
        yield "users", lambda: _users_line(project)
    if reports is not None and (printer := reports.printer) is not None:
        yield "printer", lambda: check_printer(printer)


def _check_protocol(
    project: Project[ProjectSettings], table: str, earlier: list[str] | None, check: Callable[[Any], str]
) -> str:
    """Return the line of a protocol; ``earlier`` are the servers that listen before it, None: it does not listen."""
    settings = getattr(project.settings, table)
    line = check(settings)
    if earlier is None:
        return line
    for other in (getattr(project.settings, name) for name in earlier):
        if settings.port and settings.port == other.port and _may_meet(settings.host, other.host):
            name = next(name for name in earlier if getattr(project.settings, name) is other)
            raise SettingsError(
                f"{project.path}: [{table}] port = {settings.port} is that of [{name}], too; give each server its own"
            )
    if is_running(project.resolve(project.settings.data)):
        return f"{line}, not tried while a run uses it"
    try:
        bind_socket(settings.host, settings.port).close()
    except SettingsError as error:
        raise SettingsError(f"[{table}]: {error}") from error
    return line


def _may_meet(host: str, other: str) -> bool:
    """Return whether two servers at one port listen at one address."""
    return host == other or bool({host, other} & {"0.0.0.0", "::", "localhost"})


def _list_reaches(project: Project[ProjectSettings]) -> Iterator[tuple[str, Callable[[], str]]]:
    """Yield how to reach each other machine that a run connects to: the function returns why not, or an empty text.

    While a run measures, it holds these connections, and what is wrong with them stands on its page.
    """
    settings = project.settings
    if is_running(project.resolve(settings.data)):
        return
    if (cameras := settings.cameras) is not None:
        from beltscape.sources.genicam.device import find_unreachable

        yield "source", lambda: find_unreachable(cameras)
    if (reports := settings.reports) is not None and (mail := reports.mail) is not None:
        yield "reports", lambda: find_mail_fault(mail)
    if (scale := settings.scale) is not None and (modbus := scale.modbus) is not None:
        yield "scale", lambda: find_connection_fault(modbus.host, modbus.port)
    if (outputs := settings.outputs) is not None:
        yield "outputs", lambda: find_connection_fault(outputs.host, outputs.port)
    for table, reach in REACHES.items():
        if (own := getattr(settings, table)) is not None:
            yield table, partial(reach, own)


def find_connection_fault(host: str, port: int) -> str:
    """Return why no connection to a TCP port can be made, in one line; empty if it can."""
    try:
        socket.create_connection((host, port), _PATIENCE_S).close()
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or "no answer"
        return f"{host} port {port}: {reason}"
    return ""


def _users_line(project: Project[ProjectSettings]) -> str:
    folder = project.resolve(project.settings.data)
    if not (folder / FILE).exists():
        return "none yet"
    with closing(Database(folder)) as database:
        return f"{database.select('SELECT count(*) FROM users')[0][0]} users"


def _page_line(project: Project[ProjectSettings]) -> str:
    web = project.settings.web
    if is_running(project.resolve(project.settings.data)):
        return f"{web.host} port {web.port}, not tried while a run uses it"
    check_listening(web)
    return f"{web.host} port {web.port}, {'TLS' if web.tls_certificate else 'without TLS'}"
