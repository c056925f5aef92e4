"""Reports as PDF: WeasyPrint prints the same page as the browser's print does."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

from beltscape.core.errors import InputError, describe_missing_library
from beltscape.files.atomic import write_bytes
from beltscape.report.drawing.palette import ROLES, light

REPORTS = "[reports] pdf = true"
_STYLE = """
.chart .narrow { display: none; }
.tiles { display: flex; flex-wrap: wrap; }
.tile { flex: 1 1 30mm; }
.sample { display: inline-block; }
"""
"""What WeasyPrint lays out otherwise than browsers: grids with automatic columns."""


def write_pdf(path: Path, page: str) -> None:
    """Write a page as PDF, atomically; InputError if the library is missing."""
    write_bytes(path, make_pdf(page))


def make_pdf(page: str, setting: str = REPORTS) -> bytes:
    """Return a page as PDF; InputError, which names the ``setting`` that asks for it, if the library is missing."""
    require_pdf(setting)
    from weasyprint import CSS, HTML

    # WeasyPrint knows no variables in the attributes of drawings
    page = re.sub(r"var\(--c-(\w+)\)", lambda found: light(found[1]) if found[1] in ROLES else found[0], page)
    return HTML(string=page, url_fetcher=_refuse).write_pdf(stylesheets=[CSS(string=_STYLE)])


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
