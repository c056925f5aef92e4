"""The languages of the operator's page: each is one file of texts in ``page/languages``, found by itself."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator

FOLDER = Path(__file__).parent / "page" / "languages"
DEFAULT = "en"
"""Code of the language that is the first of the list, and that every text is written in."""


@dataclass(frozen=True, slots=True)
class Language:
    """A language in which the page can be shown."""

    code: str
    """Name of its file, such as "de"."""
    name: str
    """Its name in itself."""
    locale: str
    """Locale of its numbers and times, such as "de-DE"."""
    tag: str
    """Language tag of the document (BCP 47), such as "zh-Hans"."""


def read_texts(code: str) -> dict[str, str]:
    """Return the texts of a language by their keys; OSError if it has no file."""
    return json.loads((FOLDER / f"{code}.json").read_text(encoding="utf-8"))


@cache
def list_languages() -> tuple[Language, ...]:
    """Return the languages that have a file: English, then the others in the order of their codes."""
    codes = sorted((path.stem for path in FOLDER.glob("*.json")), key=lambda code: (code != DEFAULT, code))
    return tuple(_read_language(code) for code in codes)


def _read_language(code: str) -> Language:
    texts = read_texts(code)
    return Language(code, *(texts[f"language.{part}"] for part in ("name", "locale", "tag")))


def require_language(code: str) -> str:
    """Return the code of a language that has a file; ValueError with all codes otherwise."""
    codes = [language.code for language in list_languages()]
    if code not in codes:
        raise ValueError(f"there is no language {code!r}; give one of {', '.join(codes)}")
    return code


LanguageCode = Annotated[str, AfterValidator(require_language)]
"""Code of a language that has a file."""
