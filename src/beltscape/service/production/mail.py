"""Reports by mail: an outbox of files, offered to an SMTP server until it takes them.

A report that is to be delivered, by mail or on a printer, has a mark, a file beside it; so has one that was.
"""

from __future__ import annotations

import smtplib
import ssl
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from email.message import EmailMessage
from email.utils import format_datetime
from pathlib import Path
from typing import TypeVar

from beltscape.core.errors import BeltscapeError, InputError
from beltscape.files.atomic import keep_state
from beltscape.production.settings import MailSettings

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Outbox:
    """The marks of one way of delivery."""

    folder: Path
    """The folder of the reports."""
    waiting: str
    """Ending of the mark of a report that is to be delivered."""
    done: str
    """Ending of the mark of a delivered report."""

    def mark(self, key: str) -> None:
        """Mark a report as to be delivered; it is, once it is written. OutputError if the disk refuses it."""
        keep_state(self.folder / f"{key}{self.waiting}", b"")

    @property
    def is_empty(self) -> bool:
        """Return whether nothing waits."""
        return not any(self.folder.glob(f"*{self.waiting}"))

    def is_done(self, key: str) -> bool:
        """Return whether a report was delivered."""
        waits = (self.folder / f"{key}{self.waiting}").exists()
        return not waits and (self.folder / f"{key}{self.done}").exists()

    def deliver(self, prepare: Callable[[str], Item], send: Callable[[Item], None]) -> None:
        """Send every report that waits, the oldest first.

        The error of ``send`` ends the round: that report and the later ones go on waiting. After an InputError of
        ``prepare``, which says that the report itself is damaged, it no longer waits. After a power cut before the
        mark of a sent report is changed, it is sent twice.
        """
        for mark in sorted(self.folder.glob(f"*{self.waiting}")):
            key = mark.name.removesuffix(self.waiting)
            if not (self.folder / f"{key}.html").is_file():
                continue  # it is being written
            try:
                item = prepare(key)
            except InputError:
                mark.unlink(missing_ok=True)
                raise
            send(item)
            mark.replace(mark.with_name(f"{key}{self.done}"))


_TIMEOUT_S = 30.0
"""Time for the server to answer one command."""
UNSENT, SENT = ".unsent", ".sent"
"""Endings of the marks of a report that is to be mailed, and of one that was."""
_MEDIA = {".html": ("text", "html"), ".pdf": ("application", "pdf")}
_SUBJECT_MAX = 150
"""Longest subject, characters."""


class MailError(BeltscapeError):
    """The server did not take a mail; it is offered again."""


@dataclass(frozen=True, slots=True)
class Report:
    """A report that lies in its folder."""

    key: str
    title: str
    summary: str
    made_ms: int


def read_password(settings: MailSettings) -> str:
    """Return the password; empty without one. InputError if its file cannot be read."""
    if settings.password_file is None:
        return ""
    try:
        lines = settings.password_file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"[reports.mail] password_file {settings.password_file}: cannot be read ({reason})"
        ) from error
    if not lines or not lines[0]:
        raise InputError(f"[reports.mail] password_file {settings.password_file}: its first line is empty")
    return lines[0]


def make_context(settings: MailSettings) -> ssl.SSLContext:
    """Return the TLS context; InputError if the authority cannot be read."""
    try:
        return ssl.create_default_context(cafile=None if settings.tls_ca is None else str(settings.tls_ca))
    except OSError as error:
        raise InputError(
            f"[reports.mail] tls_ca {settings.tls_ca}: cannot be read ({error.strerror or error})"
        ) from error


def make_mail(settings: MailSettings, report: Report, folder: Path) -> EmailMessage:
    """Return the mail of a report with its files; its identifier is the same every time it is offered."""
    mail = EmailMessage()
    mail["From"], mail["To"] = settings.sender, ", ".join(settings.to)
    mail["Subject"] = " ".join(report.title.split())[:_SUBJECT_MAX]
    mail["Date"] = format_datetime(datetime.fromtimestamp(report.made_ms / 1000, UTC))
    mail["Message-ID"] = f"<{report.key}.{report.made_ms}@{settings.sender.partition('@')[2]}>"
    mail["Auto-Submitted"] = "auto-generated"  # RFC 3834: no answer from a holiday
    mail.set_content(f"{report.summary}\n")
    for ending, (kind, sub) in _MEDIA.items():
        file = folder / f"{report.key}{ending}"
        if file.is_file():
            mail.add_attachment(file.read_bytes(), maintype=kind, subtype=sub, filename=file.name)
    return mail


def send_mail(settings: MailSettings, mail: EmailMessage) -> Sequence[str]:
    """Hand a mail to the server; return the recipients that it refused while it took the others.

    Raises
    ------
    MailError
        If the server cannot be reached, does not know us, or does not take it.
    """
    where = f"[reports.mail] {settings.host} port {settings.server_port}"
    try:
        with _connect(settings) as server:
            if settings.user:
                server.login(settings.user, read_password(settings))
            return list(server.send_message(mail))
    except (smtplib.SMTPException, OSError) as error:
        raise MailError(
            f"{where}: {_describe(error)}; it is offered again every {settings.retry_s:g} s"
        ) from error


def _connect(settings: MailSettings) -> smtplib.SMTP:
    address = settings.host, settings.server_port
    if settings.security == "tls":
        return smtplib.SMTP_SSL(*address, timeout=_TIMEOUT_S, context=make_context(settings))
    server = smtplib.SMTP(*address, timeout=_TIMEOUT_S)
    if settings.security == "starttls":
        try:
            server.starttls(context=make_context(settings))
        except BaseException:
            server.close()
            raise
    return server


def find_mail_fault(settings: MailSettings) -> str:
    """Return why the server cannot be reached or does not know us, in one line; empty if it would take a mail."""
    try:
        with _connect(settings) as server:
            if settings.user:
                server.login(settings.user, read_password(settings))
    except (smtplib.SMTPException, OSError) as error:
        return f"{settings.host} port {settings.server_port}: {_describe(error)}"
    return ""


def _describe(error: Exception) -> str:
    """Return an error of the connection in one line of limited length."""
    return " ".join(str(getattr(error, "strerror", None) or error).split())[:200]


def send_waiting(settings: MailSettings, outbox: Outbox, read_report: Callable[[str], Report]) -> list[str]:
    """Offer every report that waits, the oldest first; return the recipients that were refused.

    Raises
    ------
    MailError
        If the server does not take one; it and the later ones go on waiting.
    InputError
        If a report cannot be read; it no longer waits.
    """
    refused: list[str] = []

    def send(report: Report) -> None:
        refused.extend(send_mail(settings, make_mail(settings, report, outbox.folder)))

    outbox.deliver(read_report, send)
    return refused
