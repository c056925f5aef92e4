"""Render a report: ``python -m beltscape.report.production FILE.json [--pdf]`` writes FILE.html, and FILE.pdf."""

from __future__ import annotations

import sys
from pathlib import Path

from beltscape.files.atomic import write_text
from beltscape.report.production.document import ReportDocument
from beltscape.report.production.page import render_report
from beltscape.report.production.pdf import write_pdf


def main(arguments: list[str]) -> None:
    """Write the pages of one document; the HTML last, so that a report with it is whole."""
    path = Path(arguments[0])
    page = render_report(ReportDocument.model_validate_json(path.read_text(encoding="utf-8")))
    if "--pdf" in arguments[1:]:
        write_pdf(path.with_suffix(".pdf"), page)
    write_text(path.with_suffix(".html"), page)


if __name__ == "__main__":
    main(sys.argv[1:])
