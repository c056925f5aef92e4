"""Reports of shifts and days: written once each, whole in themselves, mailed until the server takes them."""

from __future__ import annotations

import json
import socket
import ssl
import subprocess
import time
from collections.abc import Iterator
from email import message_from_bytes
from email.message import Message
from pathlib import Path
from typing import Any

import pytest
from aiosmtpd.controller import Controller
from aiosmtpd.smtp import AuthResult, LoginPassword

from beltscape.core.errors import InputError, OutputError
from beltscape.production.settings import MailSettings, ReportSettings
from beltscape.report.production.document import ReportDocument
from beltscape.report.production.page import render_report
from beltscape.report.production.texts import list_languages
from beltscape.service.production import mail
from beltscape.service.production.mail import MailError
from beltscape.service.production.reports import ReportWriter, check_reports
from tests.service.production.plants import HOUR_NS, make_production
from tests.sinks.ledgers import START_NS
from tests.thorough import list_cases

LATER_NS = START_NS + 40 * HOUR_NS


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ReportWriter]:
    """The report of a day, rendered once by the process that renders (some 2 s of it)."""
    folder = tmp_path_factory.mktemp("reports")
    history, figures = make_production(folder)
    writer = ReportWriter(ReportSettings(shifts=False, pdf=True), figures, history, folder, "Quay 4", print)
    assert len(writer.write_due(LATER_NS)) == 1
    yield writer
    history.close()


def test_every_period_with_records_has_one_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    history, figures = make_production(tmp_path)
    writer = ReportWriter(ReportSettings(), figures, history, tmp_path, "Quay 4", print)
    monkeypatch.setattr(writer, "_render", lambda command: Path(command[-1]).with_suffix(".html").touch())
    assert len(writer.write_due(START_NS + 3 * HOUR_NS)) == 0  # the shift is not over
    assert len(writer.write_due(LATER_NS)) == 3
    assert writer.write_due(LATER_NS) == []
    keys = writer.list_keys()
    assert sorted(key.rpartition("_")[2] for key in keys) == ["day", "shift", "shift"]
    figures_of = [writer.read(key) for key in keys]
    assert {each.period.name for each in figures_of} == {"late", "night", ""}
    day = next(each for each in figures_of if each.period.kind == "day")
    parts = [each.period.totals for each in figures_of if each.period.kind == "shift"]
    assert day.period.totals.records == sum(each.records for each in parts) == 360
    assert day.period.totals.volume_m3 == pytest.approx(sum(each.volume_m3 for each in parts))
    assert day.period.totals.missing_m > 0
    assert [shift.name for shift in day.shifts] == ["early", "late", "night"]
    history.close()


def test_a_report_is_one_file_that_needs_no_other(written: ReportWriter) -> None:
    for key in written.list_keys():
        page = (written.folder / f"{key}.html").read_text("utf-8")
        assert "http://" not in page.replace("http://www.w3.org", "")
        assert "https://" not in page
        assert "<link" not in page
        assert (written.folder / f"{key}.pdf").read_bytes().startswith(b"%PDF-")
        assert "Quay 4" in page


@pytest.mark.parametrize("language", list_cases(list_languages(), ["zh"]))
def test_reports_speak_every_language(written: ReportWriter, language: str) -> None:
    document = written.read(written.list_keys()[-1]).model_copy(update={"language": language})
    page = render_report(document)
    assert f'<html lang="{language}">' in page
    assert "None" not in page


def test_languages_have_the_same_texts() -> None:
    folder = Path("src/beltscape/report/production/languages")
    tables = {file.stem: json.loads(file.read_text("utf-8")) for file in folder.glob("*.json")}
    for name, table in tables.items():
        assert table.keys() == tables["en"].keys(), name


def test_hostile_names_stay_text(written: ReportWriter) -> None:
    document = written.read(written.list_keys()[0])
    evil = document.model_copy(update={"plant": "<script>alert(1)</script>"})
    assert "<script>alert" not in render_report(evil)


def test_a_missing_language_or_password_is_reported(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there are de"):
        check_reports(ReportSettings(language="xx"), "UTC")
    settings = MailSettings(
        host="m", sender="a@b.c", to=("d@e.f",), user="u", password_file=tmp_path / "none"
    )
    with pytest.raises(InputError, match="password_file"):
        check_reports(ReportSettings(mail=settings), "UTC")
    with pytest.raises(ValueError, match="readable"):
        MailSettings(
            host="m", sender="a@b.c", to=("d@e.f",), user="u", password_file=tmp_path, security="none"
        )


class Inbox:
    """Takes mails, or refuses them."""

    def __init__(self) -> None:
        self.mails: list[Message] = []
        self.refuses = False

    async def handle_DATA(self, _server: Any, _session: Any, envelope: Any) -> str:  # noqa: N802
        if self.refuses:
            return "451 try later"
        self.mails.append(message_from_bytes(envelope.content))
        return "250 OK"


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("tls")
    pem, key = folder / "c.pem", folder / "k.pem"
    command = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:prime256v1",
        "-nodes",
    ]
    names = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"]
    subprocess.run(
        [*command, "-keyout", key, "-out", pem, "-days", "2", *names], check=True, capture_output=True
    )
    return pem, key


def serve_mail(inbox: Inbox, certificate: tuple[Path, Path] | None = None) -> Controller:
    if certificate is None:
        return Controller(inbox, hostname="127.0.0.1", port=find_free_port())
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*certificate)

    def authenticate(_server: Any, _session: Any, _envelope: Any, _mechanism: str, data: Any) -> AuthResult:
        assert isinstance(data, LoginPassword)
        return AuthResult(success=(data.login, data.password) == (b"belt", b"secret word"))

    return Controller(
        inbox, hostname="127.0.0.1", port=find_free_port(), tls_context=context, require_starttls=True,
        authenticator=authenticate, auth_required=True,
    )  # fmt: skip


def find_free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def mark_unsent(writer: ReportWriter) -> None:
    for key in writer.list_keys():
        (writer.folder / f"{key}.unsent").touch()


def with_mail(writer: ReportWriter, settings: MailSettings) -> None:
    writer._settings = ReportSettings(pdf=True, mail=settings)


def test_reports_are_mailed_once_and_after_a_failure_again(written: ReportWriter) -> None:
    inbox = Inbox()
    server = serve_mail(inbox)
    server.start()
    try:
        port = server.port
        with_mail(
            written,
            MailSettings(host="127.0.0.1", port=port, security="none", sender="b@x.org", to=("a@x.org",)),
        )
        mark_unsent(written)
        inbox.refuses = True
        with pytest.raises(MailError, match="try later"):
            written.mail()
        inbox.refuses = False
        written.mail()
        written.mail()
    finally:
        server.stop()
    assert len(inbox.mails) == 1
    kinds = [part.get_content_type() for part in inbox.mails[0].walk()]
    assert kinds == ["multipart/mixed", "text/plain", "text/html", "application/pdf"]
    assert "Quay 4" in inbox.mails[0]["Subject"]
    assert "m³" in inbox.mails[0].get_payload()[0].get_payload(decode=True).decode()  # pyrefly: ignore[bad-index, missing-attribute]
    assert all(written.is_mailed(key) for key in written.list_keys())


def test_a_server_that_is_away_is_named_and_the_mails_wait(written: ReportWriter) -> None:
    with_mail(
        written, MailSettings(host="127.0.0.1", port=1, security="none", sender="b@x.org", to=("a@x.org",))
    )
    mark_unsent(written)
    with pytest.raises(MailError, match=r"127.0.0.1 port 1.*offered again"):
        written.mail()
    assert not any(written.is_mailed(key) for key in written.list_keys())


def test_a_password_that_cannot_be_read_loses_no_mail(
    written: ReportWriter, certificate: tuple[Path, Path], tmp_path: Path
) -> None:
    server = serve_mail(Inbox(), certificate)
    server.start()
    try:
        settings = MailSettings(
            host="localhost", port=server.port, sender="b@x.org", to=("a@x.org",),
            user="belt", password_file=tmp_path / "gone", tls_ca=certificate[0],
        )  # fmt: skip
        with_mail(written, settings)
        mark_unsent(written)
        with pytest.raises(InputError, match="gone: cannot be read"):
            written.mail()
    finally:
        server.stop()
    assert all((written.folder / f"{key}.unsent").exists() for key in written.list_keys())


def test_starttls_with_a_password(
    written: ReportWriter, certificate: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        mail, "_TIMEOUT_S", 1.0
    )  # the test's server never answers a second attempt to sign in
    inbox, password = Inbox(), tmp_path / "password"
    password.write_text("secret word\n")
    server = serve_mail(inbox, certificate)
    server.start()
    try:
        common = {"host": "localhost", "port": server.port, "sender": "b@x.org", "to": ("a@x.org",)}
        right = MailSettings(**common, tls_ca=certificate[0], user="belt", password_file=password)
        mark_unsent(written)
        for wrong in (
            MailSettings(**common, user="belt", password_file=password),  # an unknown authority
            MailSettings(**common, tls_ca=certificate[0], user="other", password_file=password),
            MailSettings(**common, tls_ca=certificate[0]),
        ):
            with_mail(written, wrong)
            with pytest.raises(MailError):
                written.mail()
        assert inbox.mails == []
        with_mail(written, right)
        written.mail()
    finally:
        server.stop()
    assert len(inbox.mails) == 1


def test_the_thread_writes_by_itself_and_ends(tmp_path: Path) -> None:
    history, figures = make_production(tmp_path, records=5)
    writer = ReportWriter(ReportSettings(days=False), figures, history, tmp_path, "", print)
    writer.write_due = lambda _: []  # pyrefly: ignore[bad-assignment]
    writer.start()
    time.sleep(0.05)
    writer.close()
    assert not writer._thread.is_alive()
    history.close()


def test_a_report_that_fails_delays_no_other_and_is_reported_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    history, figures = make_production(tmp_path)
    messages = list[str]()
    writer = ReportWriter(ReportSettings(), figures, history, tmp_path, "", messages.append)

    def render(command: list[str]) -> None:
        if command[-1].endswith("_day.json"):
            raise OutputError("cannot be rendered")
        Path(command[-1]).with_suffix(".html").touch()

    monkeypatch.setattr(writer, "_render", render)
    for _ in range(3):
        writer._attempt("write", lambda: bool(writer.write_due(LATER_NS)))
    assert len(writer.list_keys()) == 2
    assert messages == ["cannot be rendered"]
    history.close()


def test_a_document_reads_back(written: ReportWriter) -> None:
    document = written.read(written.list_keys()[0])
    assert ReportDocument.model_validate_json(document.model_dump_json()) == document
