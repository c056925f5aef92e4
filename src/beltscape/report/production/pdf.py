"""Reports as PDF: WeasyPrint prints the same page as the browser's print does."""

from __future__ import annotations

import logging
import re
from collections.abc import Generator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from beltscape.core.errors import InputError, describe_missing_library
from beltscape.files.atomic import write_bytes
from beltscape.report.drawing.palette import ROLES, light

if TYPE_CHECKING:
    from weasyprint import Document

REPORTS = "[reports] pdf = true"
_STYLE = """
.chart .narrow { display: none; }
.tiles { display: flex; flex-wrap: wrap; }
.tile { flex: 1 1 30mm; }
.sample { display: inline-block; }
"""
"""What WeasyPrint lays out otherwise than browsers: grids with automatic columns."""
_FOOT = """
h1 { string-set: title content(); }
@page {
  @bottom-left { content: string(title); font: 8pt sans-serif; color: #555; }
  @bottom-right { content: counter(page) " / " counter(pages); font: 8pt sans-serif; color: #555; }
}
"""
"""Foot of every page: whose page it is, which one and of how many (ISO/IEC 17025, 7.8.2.1, of certificates)."""
_MOST_NAMED = 8
"""Characters without a font that a line names."""


def write_pdf(path: Path, page: str) -> None:
    """Write a page as PDF, atomically; InputError if the library is missing."""
    write_bytes(path, make_pdf(page))


def make_pdf(page: str, setting: str = REPORTS) -> bytes:
    """Return a page as PDF.

    Raises
    ------
    InputError
        With the ``setting`` that asks for it, if the library is missing, or no font has a letter of the page.
    """
    require_pdf(setting)
    with _find_missing_letters() as missing:
        content = lay_out(page).write_pdf()
    if missing:
        raise InputError(
            f"{setting}: no font of this machine has {', '.join(missing[:_MOST_NAMED])}"
            f"{' and others' if len(missing) > _MOST_NAMED else ''}; install one, such as: "
            "apt install fonts-wqy-microhei (Chinese), fonts-dejavu-core (others)"
        )
    return content


def lay_out(page: str) -> Document:
    """Return the laid-out pages of a page, each with its title and number at the foot."""
    from weasyprint import CSS, HTML

    # WeasyPrint knows no variables in the attributes of drawings
    page = re.sub(r"var\(--c-(\w+)\)", lambda found: light(found[1]) if found[1] in ROLES else found[0], page)
    return HTML(string=page, url_fetcher=_refuse).render(stylesheets=[CSS(string=_STYLE + _FOOT)])


@contextmanager
def _find_missing_letters() -> Generator[list[str]]:
    """Yield the letters that are drawn as boxes in the context; WeasyPrint only logs them."""
    found: list[str] = []

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            named = record.args if isinstance(record.args, tuple) else ()
            if str(record.msg).startswith(".notdef glyph") and len(named) == 2 and named[0] not in found:
                found.append(str(named[0]))

    log, collector = logging.getLogger("weasyprint"), Collector(logging.WARNING)
    log.addHandler(collector)
    try:
        yield found
    finally:
        log.removeHandler(collector)


def require_pdf(setting: str = REPORTS) -> None:
    """Raise InputError with the line to type if PDF cannot be written here."""
    try:
        import_module("weasyprint")
    except ImportError as error:
        raise InputError(f"{setting}: {describe_missing_library(error) or error}") from error
    except OSError as error:  # Pango is no Python library
        raise InputError(
            f"{setting}: this needs Pango; run: apt install libpango-1.0-0 libpangoft2-1.0-0 "
            f"({' '.join(str(error).split())[:120]})"
        ) from error


def _refuse(url: str, *_: object, **__: object) -> dict[str, object]:
    """Fetch nothing: a report is complete in itself."""
    raise ValueError(f"{url[:60]}: not fetched")
