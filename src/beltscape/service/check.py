"""The check of a whole project before it runs: `beltscape run --check`."""

from __future__ import annotations

from contextlib import closing
from functools import partial

from beltscape.core.errors import BeltscapeError
from beltscape.core.progress import Reporter
from beltscape.pipeline.live.check import is_running, list_checks
from beltscape.pipeline.live.project import Project
from beltscape.service.access.identity.database import FILE, Database
from beltscape.service.hosting.server import check_listening
from beltscape.service.production.report_checks import check_reports_and_printer
from beltscape.service.production.scale_counter import check_scale
from beltscape.service.project import ProjectSettings
from beltscape.service.protocols.checks import CHECKS


def check_plant(project: Project[ProjectSettings], reporter: Reporter, *, page: bool) -> dict[str, str]:
    """Return one line for each part that a run would open.

    Raises
    ------
    BeltscapeError
        The first fault, with the names of the other parts that have one.
    """
    lines: dict[str, str] = {}
    faults: dict[str, BeltscapeError] = {}
    checks = list(list_checks(project, reporter))
    if page:
        checks.append(("page", lambda: _page_line(project)))
        checks.append(("users", lambda: _users_line(project)))
    reports = project.settings.reports
    if reports is not None:
        zone = project.settings.production.time_zone
        checks.append(("reports", lambda: check_reports_and_printer(reports, zone)))
    scale = project.settings.scale
    if scale is not None:
        checks.append(("scale", lambda: check_scale(scale)))
    for table, check_protocol in CHECKS.items():
        if (settings := getattr(project.settings, table)) is not None:
            checks.append((table, partial(check_protocol, settings)))
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
    return lines


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
