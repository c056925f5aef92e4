"""The texts of certificates, explanations and budgets: the same keys in all languages, and none unused."""

from __future__ import annotations

import json
import re
from importlib.resources import files

import pytest

from beltscape.metrology.document import UNITS
from beltscape.report.production.texts import list_languages

FOLDER = files("beltscape.report.metrology") / "languages"
ENGLISH = json.loads((FOLDER / "en.json").read_text(encoding="utf-8"))
MADE = ("note.", "effect.", "result.", "part.", "part_name.", "how.", "advice.", "budget.note.", "kind.", "type.",
        "column.", "reference.", "sample.", "verdict.", "standing.", "explain.", "linearity.",
        "lack_of_fit.", "drift.note.", "drift.part.", "drift.action.", "drift.column.")  # fmt: skip
"""Beginnings of keys that are put together."""


@pytest.mark.parametrize("language", list_languages())
def test_every_language_has_every_text(language) -> None:
    words = json.loads((FOLDER / f"{language}.json").read_text(encoding="utf-8"))
    assert set(words) == set(ENGLISH)
    for key, text in words.items():
        assert set(re.findall(r"\{(\w+)\}", text)) == set(re.findall(r"\{(\w+)\}", ENGLISH[key])), key
        assert text.strip() == text or key == "group", key


def test_no_text_is_unused() -> None:
    source = "".join(
        file.read_text(encoding="utf-8")
        for package in ("beltscape.report.metrology", "beltscape.report.production")
        for file in files(package).iterdir()
        if file.name.endswith(".py")
    )
    unused = [key for key in ENGLISH if not key.startswith(MADE) and f'"{key}"' not in source]
    assert [
        key for key in unused if key not in ("product", "operator", "place", "remark", "name", "moment")
    ] == []


def test_every_result_has_a_name() -> None:
    assert {f"result.{key}" for key in UNITS} <= set(ENGLISH)
