"""Printing of reports: a program in place of CUPS takes, refuses or hangs; nothing is lost and nothing is silent."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from beltscape.core.errors import InputError
from beltscape.production.settings import ReportSettings
from beltscape.service.production import printing
from beltscape.service.production.printing import PrintError, check_printer, print_report
from beltscape.service.production.reports import ReportWriter, check_reports_and_printer
from tests.service.production.plants import HOUR_NS, make_production
from tests.sinks.ledgers import START_NS

PDF = b"%PDF-1.7 report"
LP = """#!/bin/sh
case "$(cat "$HERE/mode")" in
  refuse) echo "lp: The printer or class does not exist." >&2; exit 1;;
  hang) sleep 60 & wait;;
esac
for word in "$@"; do printf '%s\\n' "$word" >> "$HERE/words"; done
cat "$6" "$4" 2>/dev/null >> "$HERE/paper"
echo "request id is office-1 (1 file(s))"
"""
LPSTAT = """#!/bin/sh
case "$(cat "$HERE/mode") $1 $2" in
  "nodefault -d "*) echo "no system default destination";;
  *" -d "*) echo "system default destination: office";;
  *" -p office") echo "printer office is idle.";;
  *) echo "lpstat: Invalid destination name in list \\"$2\\"." >&2; exit 1;;
esac
"""


class Cups:
    """The commands of CUPS in a folder of PATH."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        folder.mkdir()
        for name, text in (("lp", LP), ("lpstat", LPSTAT)):
            (folder / name).write_text(text)
            (folder / name).chmod(0o755)
        monkeypatch.setenv("HERE", str(folder))
        monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
        self.set_mode("take")

    def set_mode(self, mode: str) -> None:
        (self.folder / "mode").write_text(mode)

    @property
    def words(self) -> list[str]:
        path = self.folder / "words"
        return path.read_text().splitlines() if path.exists() else []


@pytest.fixture
def cups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Cups:
    return Cups(tmp_path / "cups", monkeypatch)


@pytest.fixture
def pdf(tmp_path: Path) -> Path:
    path = tmp_path / "-report $(touch owned) 'ä'.pdf"
    path.write_bytes(PDF)
    return path


@dataclass
class Reports:
    """A writer whose days are rendered by a line of its own, with what it reports."""

    writer: ReportWriter
    messages: list[str] = field(default_factory=list)
    troubles: list[str] = field(default_factory=list)

    def attempt(self) -> None:
        """Print as the thread does when the wait after a failure is over."""
        self.writer._next_s.clear()
        self.writer._attempt("print", self.writer.print)


MakeReports = Callable[[str], Reports]


@pytest.fixture
def make_reports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[MakeReports]:
    """Return a function that makes the reports of a day for a printer."""
    history, figures = make_production(tmp_path / "data", records=60)

    def render(command: list[str]) -> None:
        document = next(Path(word) for word in command if word.endswith(".json"))
        document.with_suffix(".pdf").write_bytes(PDF)
        document.with_suffix(".html").touch()

    def make(printer: str) -> Reports:
        settings = ReportSettings(shifts=False, pdf=True, printer=printer)
        messages, troubles = list[str](), list[str]()
        writer = ReportWriter(
            settings, figures, history, tmp_path / "data", "Quay 4", messages.append, troubles.append
        )
        monkeypatch.setattr(writer, "_render", render)
        assert len(writer.write_due(START_NS + 40 * HOUR_NS)) == 1
        return Reports(writer, messages, troubles)

    yield make
    history.close()


def test_a_pdf_goes_to_the_printer_as_words_and_not_through_a_shell(cups: Cups, pdf: Path) -> None:
    print_report("office", pdf, "Quay 4; rm -rf /\n `id`\0")
    assert cups.words == ["-d", "office", "-t", "Quay 4; rm -rf / `id`", "--", str(pdf)]
    assert (cups.folder / "paper").read_bytes() == PDF
    print_report("default", pdf, "-t")
    assert cups.words[6:] == ["-t", "-t", "--", str(pdf)]
    assert not (Path.cwd() / "owned").exists()


@pytest.mark.parametrize(
    ("printer", "mode", "words"),
    [
        ("garage", "take", 'printer = "garage": CUPS does not know it .*Invalid destination'),
        ("default", "nodefault", "no default printer; name one"),
    ],
)
def test_a_printer_that_does_not_exist_is_named_by_the_check(
    cups: Cups, printer: str, mode: str, words: str
) -> None:
    cups.set_mode(mode)
    settings = ReportSettings(pdf=True, printer=printer)
    with pytest.raises(PrintError, match=words) as caught:
        check_reports_and_printer(settings, "UTC")
    assert "\n" not in str(caught.value)


def test_the_check_says_what_prints(cups: Cups) -> None:
    assert check_printer("default") == "office"
    line = check_reports_and_printer(ReportSettings(pdf=True, printer="office"), "UTC")
    assert line.endswith("printed on office")


def test_a_missing_lp_is_named(tmp_path: Path, pdf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    for attempt in (lambda: check_printer("office"), lambda: print_report("office", pdf, "x")):
        with pytest.raises(PrintError, match=r"command lp is missing; run: apt install cups-client"):
            attempt()


def test_a_command_that_hangs_is_ended_with_its_children(
    cups: Cups, pdf: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cups.set_mode("hang")
    monkeypatch.setattr(printing, "_TIMEOUT_S", 0.3)
    began = time.process_time(), time.monotonic()
    with pytest.raises(PrintError, match="does not answer and was ended"):
        print_report("office", pdf, "x")
    monkeypatch.setattr(printing, "_TIMEOUT_S", 60.0)
    with pytest.raises(PrintError, match="ended"):
        print_report("office", pdf, "x", lambda _: True)  # the service stops
    assert time.monotonic() - began[1] < 30 and time.process_time() - began[0] < 2


def test_a_report_waits_until_the_printer_takes_it_and_is_printed_once(
    cups: Cups, make_reports: MakeReports
) -> None:
    reports = make_reports("office")
    writer, (key,) = reports.writer, reports.writer.list_keys()
    cups.set_mode("refuse")
    for _ in range(3):
        reports.attempt()
    assert len(reports.messages) == 1 and "does not exist" in reports.messages[0]
    assert reports.troubles == reports.messages * 3
    assert not writer.is_printed(key) and (writer.folder / f"{key}.unprinted").exists()
    cups.set_mode("take")
    for _ in range(2):
        reports.attempt()
    assert writer.is_printed(key) and not writer.is_mailed(key) and reports.troubles[-1] == ""
    assert (cups.folder / "paper").read_bytes() == PDF
    assert cups.words.count("-d") == 1 and any("Quay 4" in word for word in cups.words)
    assert writer.write_due(START_NS + 41 * HOUR_NS) == []


def test_a_missing_printer_is_a_trouble_before_there_is_anything_to_print(
    cups: Cups, make_reports: MakeReports
) -> None:
    reports = make_reports("garage")
    for path in reports.writer.folder.glob("*.unprinted"):
        path.unlink()
    reports.attempt()
    assert "garage" in reports.troubles[-1] and cups.words == []


def test_a_pdf_that_is_gone_stops_no_other(cups: Cups, make_reports: MakeReports) -> None:
    writer = make_reports("office").writer
    (key,) = writer.list_keys()
    (writer.folder / f"{key}.pdf").unlink()
    with pytest.raises(InputError, match="no such PDF"):
        writer.print()
    writer.print()
    assert not (writer.folder / f"{key}.unprinted").exists() and cups.words == []


@pytest.mark.parametrize("printer", ["", "-o raw", "a b", "a,b", "a/b", "#", "x" * 128])
def test_a_name_that_is_none_is_refused(printer: str) -> None:
    with pytest.raises(ValueError, match="printer"):
        ReportSettings(pdf=True, printer=printer)


def test_a_printer_without_a_pdf_is_refused() -> None:
    with pytest.raises(ValueError, match="give pdf = true as well"):
        ReportSettings(printer="office")
