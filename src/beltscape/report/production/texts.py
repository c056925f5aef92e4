"""The words of a report in a language, numbers and times as they are written in it, and a report's title and result.

Title and result are one line each: heads of the page, subject and text of the mail.
A language is a file ``languages/<code>.json``; another one is added by adding its file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.resources import files
from math import floor, isfinite, log10
from zoneinfo import ZoneInfo

from beltscape.core.errors import InputError
from beltscape.report.production.document import ReportDocument


@dataclass(frozen=True, slots=True)
class Texts:
    """The words of one language, with the time zone of its times."""

    words: Mapping[str, str]
    zone: ZoneInfo

    def __call__(self, key: str, **values: str) -> str:
        """Return a text with its values."""
        return self.words[key].format(**values)

    def number(self, value: float | None, digits: int) -> str:
        """Return a number with that many digits behind the point; a dash where it is not known."""
        if value is None or not isfinite(value):
            return "–"
        text = f"{value:,.{digits}f}".replace("-", "−")
        marks = str.maketrans({",": self.words["group"], ".": self.words["decimal"]})
        return text.translate(marks)

    def short(self, value: float) -> str:
        """Return a number as somebody gave it, without more digits."""
        return f"{value:g}".replace("-", "−").replace(".", self.words["decimal"])

    def with_sigma(self, value: float | None, sigma: float | None) -> str:
        """Return value ± σ to two significant digits of σ (GUM 7.2.6)."""
        if value is None or sigma is None or not (isfinite(value) and isfinite(sigma)):
            return "–"
        digits = 3 if sigma <= 0 else min(max(1 - floor(log10(sigma)), 0), 6)
        return f"{self.number(value, digits)} ± {self.number(sigma, digits)}"

    def moment(self, wall_ms: int) -> str:
        """Return local date and time to the minute."""
        return f"{self._local(wall_ms):{self.words['moment']}}"

    def clock(self, wall_ms: int) -> str:
        """Return the local time of day."""
        return f"{self._local(wall_ms):%H:%M}"

    def _local(self, wall_ms: int) -> datetime:
        return datetime.fromtimestamp(wall_ms / 1000, UTC).astimezone(self.zone)


PRODUCTION = "beltscape.report.production"
"""Package whose folder ``languages`` has the texts of reports."""


def open_texts(
    language: str, zone: str, package: str = PRODUCTION, setting: str = "[reports] language"
) -> Texts:
    """Return the texts of a language; InputError with the languages that there are if it is none of them.

    ``package`` has them in its folder ``languages``; ``setting`` names in the error what gave the language.
    """
    languages = list_languages()
    if language not in languages:
        raise InputError(f"{setting} = {language!r}: there are {', '.join(languages)}")
    return Texts(_read(language, package), ZoneInfo(zone))


def list_languages() -> list[str]:
    """Return the codes of all languages."""
    folder = files(PRODUCTION) / "languages"
    return sorted(file.name.removesuffix(".json") for file in folder.iterdir() if file.name.endswith(".json"))


@cache
def _read(language: str, package: str) -> Mapping[str, str]:
    file = files(package) / "languages" / f"{language}.json"
    return json.loads(file.read_text(encoding="utf-8"))


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
