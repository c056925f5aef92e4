"""The check of the reports' settings: language, libraries, the files of the mail, the printer."""

from __future__ import annotations

from beltscape.production.settings import ReportSettings
from beltscape.report.production.pdf import require_pdf
from beltscape.report.production.texts import open_texts
from beltscape.service.production.mail import make_context, read_password
from beltscape.service.production.printing import check_printer


def check_reports(settings: ReportSettings, zone: str) -> str:
    """Return what would be reported; InputError where it cannot be."""
    open_texts(settings.language, zone)
    if settings.pdf:
        require_pdf()
    what = " and ".join(name for name in ("shifts", "days") if getattr(settings, name)) or "nothing"
    line = f"{what}, in {settings.folder}"
    if settings.mail is not None:
        read_password(settings.mail)
        make_context(settings.mail)
        line += f", mailed by {settings.mail.host} port {settings.mail.server_port}"
    return line if settings.printer is None else f"{line}, printed on {settings.printer}"


def check_reports_and_printer(settings: ReportSettings, zone: str) -> str:
    """Return what would be reported; InputError or PrintError where it cannot be, also where the printer is missing.

    A run starts without its printer, which may be switched on later, and raises an alarm.
    """
    line = check_reports(settings, zone)
    if settings.printer is not None:
        check_printer(settings.printer)
    return line
