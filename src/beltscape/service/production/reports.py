"""The reports of shifts and days: written when they are over, rendered by a process of its own, and delivered.

Their settings are checked before: language, libraries, the files of the mail, the printer.
"""

from __future__ import annotations

import os
import re
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic, time_ns

from beltscape.core.errors import BeltscapeError, InputError, OutputError, describe_cause
from beltscape.core.supervision import make_supervised_thread
from beltscape.files.atomic import ensure_output_folder, keep_state
from beltscape.production.settings import ReportSettings
from beltscape.production.shifts import Period, PeriodKind
from beltscape.report.production.document import ChangeOut, FlowIntervals, ReportDocument
from beltscape.report.production.pdf import require_pdf
from beltscape.report.production.texts import make_title, open_texts, summarise
from beltscape.service.production.figures import ProductionFigures
from beltscape.service.production.mail import (
    SENT,
    UNSENT,
    Outbox,
    Report,
    make_context,
    read_password,
    send_waiting,
)
from beltscape.service.production.printing import PRINTED, UNPRINTED, check_printer, print_report, run_command
from beltscape.sinks.historian import Historian


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


_POLL_S = 10.0
"""Interval at which finished shifts are looked for. Chosen."""
_SETTLE_NS = 60 * 10**9
"""Wait after the end of a shift, until its last records are written."""
_CATCH_UP_NS = 7 * 86_400 * 10**9
"""Shifts that ended while nothing ran get their reports up to this age. Chosen."""
_RENDER_S = 300.0
"""Time for rendering a report; it takes some seconds."""
_RETRY_S = 300.0
"""Wait after a report that could not be written or printed: rendering takes seconds of a processor. Chosen."""
_FLOW_POINTS = 96
"""Bars of the flow: quarters of an hour of a day."""
_KEY = re.compile(r"\d{8}T\d{4}Z_(shift|day)")
_ENDINGS = (".html", ".pdf", ".json", UNSENT, SENT, UNPRINTED, PRINTED)
"""Endings of the files of a report."""
_MS_NS = 1_000_000
"""Nanoseconds of a millisecond."""
_DAY_NS = 86_400 * 10**9
"""Nanoseconds of a day."""
_NICE = 10
"""Priority of rendering below the measurement."""


class ReportWriter:
    """Writes, mails and prints the reports that are due, in a thread of its own, until it is closed."""

    def __init__(
        self,
        settings: ReportSettings,
        figures: ProductionFigures,
        historian: Historian,
        data: Path,
        plant: str,
        on_message: Callable[[str], None],
        on_trouble: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Prepare; ``data`` is the folder of a relative ``settings.folder``.

        ``on_trouble`` gets after every attempt why reports are not delivered; empty: they are.

        Raises
        ------
        InputError
            If the language, the PDF library or a file of the mail is missing.
        """
        check_reports(settings, figures.control.settings.time_zone)
        self.folder = ensure_output_folder(data / settings.folder)
        self._mails = Outbox(self.folder, UNSENT, SENT)
        self._prints = Outbox(self.folder, UNPRINTED, PRINTED)
        self._settings, self._figures, self._historian = settings, figures, historian
        self._plant, self._on_message, self._on_trouble = plant, on_message, on_trouble
        self._empty: set[str] = set()
        """Shifts and days in which nothing ran."""
        self._stop = threading.Event()
        self._troubles: dict[str, str] = {}
        self._printer_s = 0.0
        """Monotonic clock at which the printer is looked for again where nothing waits for it."""
        self._next_s: dict[str, float] = {}
        self._wait_s = {} if settings.mail is None else {"mail": settings.mail.retry_s}
        self._thread = make_supervised_thread("reports", self._run, on_message, self._stop.wait)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self, patience_s: float = 5.0) -> None:
        """Stop it; what is not mailed or printed waits for the next start."""
        self._stop.set()
        self._thread.join(patience_s)

    def list_keys(self) -> list[str]:
        """Return the names of all reports, newest first."""
        return sorted((path.stem for path in self.folder.glob("*.html")), reverse=True)

    def find_file(self, key: str, ending: str) -> Path | None:
        """Return a file of a report; None if there is none of that name."""
        if not _KEY.fullmatch(key):
            return None
        path = self.folder / f"{key}{ending}"
        return path if path.is_file() else None

    def is_mailed(self, key: str) -> bool:
        """Return whether a report was handed to the mail server."""
        return self._mails.is_done(key)

    def is_printed(self, key: str) -> bool:
        """Return whether a report was handed to the printer."""
        return self._prints.is_done(key)

    def read(self, key: str) -> ReportDocument:
        """Return the figures of a report; InputError if its file is damaged."""
        path = self.folder / f"{key}.json"
        try:
            return ReportDocument.model_validate_json(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: cannot be read ({describe_cause(error)})") from error

    def write_due(self, now_ns: int) -> list[str]:
        """Write the reports of all shifts and days that are over and have none; return their names.

        Raises
        ------
        BeltscapeError
            The first failure, after the others have been tried.
        """
        written, failures = list[str](), list[BeltscapeError]()
        first_ns = self._historian.totals.since_ns
        if first_ns is None:
            return written
        for kind in self._list_kinds():
            for period in self._figures.list_periods(kind, max(first_ns, now_ns - _CATCH_UP_NS), now_ns):
                try:
                    if self._is_due(period, now_ns) and self._write(period, now_ns):
                        written.append(period.key)
                except BeltscapeError as error:
                    failures.append(error)
        if written:
            self._remove_old(now_ns)
        if failures:
            raise failures[0]
        return written

    def _list_kinds(self) -> list[PeriodKind]:
        """Return what is reported; the shifts are those of the present settings."""
        has_shifts = bool(self._figures.control.settings.shifts)
        kinds: Sequence[tuple[PeriodKind, bool]] = (
            ("shift", self._settings.shifts and has_shifts),
            ("day", self._settings.days),
        )
        return [kind for kind, is_on in kinds if is_on]

    def _is_due(self, period: Period, now_ns: int) -> bool:
        is_over = period.until_ns + _SETTLE_NS <= now_ns
        return is_over and period.key not in self._empty and self.find_file(period.key, ".html") is None

    def compose(self, period: Period, now_ns: int) -> ReportDocument:
        """Return the figures of a shift or a day."""
        control, since, until = self._figures.control, period.since_ns, period.until_ns
        shifts = self._figures.list_periods("shift", since, until) if period.kind == "day" else []
        changes = [*control.history.changes(0, since)[-1:], *control.history.changes(since, until)]
        series = self._historian.series(since, until, _FLOW_POINTS)
        return ReportDocument(
            plant=self._plant,
            language=self._settings.language,
            time_zone=control.settings.time_zone,
            made_ms=now_ns // _MS_NS,
            period=self._figures.count_period(period),
            shifts=[self._figures.count_period(shift) for shift in shifts],
            batches=self._figures.list_batches(since, until)[::-1],
            changes=[ChangeOut(at_ms=c.wall_ns // _MS_NS, product=c.product, by=c.by) for c in changes],
            flow=FlowIntervals(
                width_ms=series.width_ns // _MS_NS,
                start_ms=[int(each) // _MS_NS for each in series.start_ns],
                m3_h=[float(each) for each in series.flow_m3_h],
            ),
            colours={product.name: product.colour for product in control.products},
        )

    def _write(self, period: Period, now_ns: int) -> bool:
        """Write the report of a period; return whether it has any records to report."""
        document = self.folder / f"{period.key}.json"
        figures = self.compose(period, now_ns)
        if not figures.period.totals.records:
            self._empty.add(period.key)
            return False
        keep_state(document, (figures.model_dump_json(indent=1) + "\n").encode())
        for wanted, outbox in ((self._settings.mail, self._mails), (self._settings.printer, self._prints)):
            if wanted is not None:
                outbox.mark(period.key)
        command = [sys.executable, "-m", "beltscape.report.production", str(document)]
        command += ["--pdf"] if self._settings.pdf else []
        self._render(command)
        self._figures.control.events.add("report", period.key, make_title(figures), now_ns)
        return True

    def _render(self, command: list[str]) -> None:
        """Render in a process of its own, so that no frame waits for it."""
        if os.name == "posix":
            command = ["nice", "-n", str(_NICE), *command]
        try:
            done = run_command(command, _RENDER_S, self._stop.wait)
        except OSError as error:
            raise OutputError(f"[reports]: {command[-1]}: cannot be rendered ({error})") from error
        if done is None:
            raise OutputError(f"[reports]: {command[-1]}: rendering was ended before it was done")
        if done.code:
            lines = done.errors.strip().splitlines() or [f"exit code {done.code}"]
            raise OutputError(f"[reports]: {command[-1]}: cannot be rendered ({lines[-1][:200]})")

    def mail(self) -> None:
        """Offer the reports that are not mailed yet. MailError if one is not taken."""
        if self._settings.mail is None:
            return
        refused = send_waiting(self._settings.mail, self._mails, self._summarise)
        if refused:
            self._on_message(f"[reports.mail] to: the server refused {', '.join(sorted(set(refused)))}")

    def print(self) -> None:
        """Hand the reports that are not printed yet to the printer. PrintError if it is missing or refuses one."""
        printer = self._settings.printer
        if printer is None or (self._prints.is_empty and monotonic() < self._printer_s):
            return
        check_printer(printer, self._stop.wait)
        self._printer_s = monotonic() + _RETRY_S

        def send(found: tuple[Path, str]) -> None:
            print_report(printer, *found, self._stop.wait)

        self._prints.deliver(self._find_pdf, send)

    def _find_pdf(self, key: str) -> tuple[Path, str]:
        """Return the PDF of a report and its title; InputError if it is gone."""
        pdf = self.folder / f"{key}.pdf"
        if not pdf.is_file():
            raise InputError(f"[reports] printer: {pdf}: there is no such PDF; it is not printed")
        return pdf, make_title(self.read(key))

    def _summarise(self, key: str) -> Report:
        document = self.read(key)
        return Report(key, make_title(document), summarise(document), document.made_ms)

    def _remove_old(self, now_ns: int) -> None:
        oldest_s = (now_ns - self._settings.keep_days * _DAY_NS) / 1e9
        for path in self.folder.iterdir():
            if path.suffix in _ENDINGS and path.stat().st_mtime < oldest_s:
                path.unlink(missing_ok=True)

    def _run(self) -> None:
        while True:
            self._attempt("write", lambda: self.write_due(time_ns()))
            self._attempt("mail", self.mail)
            self._attempt("print", self.print)
            if self._stop.wait(_POLL_S):
                return

    def _attempt(self, name: str, step: Callable[[], object]) -> None:
        """Take a step, after a failure only when its wait is over; report a failure once until the step succeeds."""
        if self._stop.is_set() or monotonic() < self._next_s.get(name, 0.0):
            return
        try:
            step()
            self._troubles[name] = ""
        except (BeltscapeError, OSError) as error:
            self._next_s[name] = monotonic() + self._wait_s.get(name, _RETRY_S)
            if self._stop.is_set():
                return
            if self._troubles.get(name) != str(error):
                self._troubles[name] = str(error)
                self._on_message(str(error))
        self._on_trouble(next((trouble for trouble in self._troubles.values() if trouble), ""))
