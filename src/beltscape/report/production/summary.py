"""Title and result of a report in one line each: heads of the page, subject and text of the mail."""

from __future__ import annotations

from beltscape.report.production.document import ReportDocument
from beltscape.report.production.texts import open_texts


def make_title(document: ReportDocument) -> str:
    """Return the title: plant, shift or day, and date."""
    texts, period = open_texts(document.language, document.time_zone), document.period
    name = texts(f"title.{period.kind}", name=period.name)
    return " · ".join(part for part in (document.plant, name, period.day) if part)


def summarise(document: ReportDocument) -> str:
    """Return the totals in one sentence."""
    texts, totals = open_texts(document.language, document.time_zone), document.period.totals
    mass = texts.with_sigma(totals.mass_t, totals.mass_sigma_t)
    return texts(
        "verdict",
        from_=texts.moment(document.period.since_ms),
        until=texts.moment(document.period.until_ms),
        volume=texts.with_sigma(totals.volume_m3, totals.sigma_m3),
        mass=texts("mass", mass=mass) if totals.mass_t is not None else "",
    )
