"""All words of the page lie in one file, in every language, and nowhere else."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from string import Formatter
from typing import get_args

import pytest

from beltscape.alarms.settings import AlarmSettings
from beltscape.core.belt.ledger_entries import STANDINGS
from beltscape.core.live import AlarmState, CameraState, Severity
from beltscape.service.access.identity.roles import ROLES
from beltscape.service.settings import Language
from beltscape.service.static import FOLDER
from beltscape.service.view_models.flow import Trend

TEXTS: dict[str, dict[str, str]] = json.loads((FOLDER / "texts.json").read_text(encoding="utf-8"))
SCRIPTS = {path.name: path.read_text(encoding="utf-8") for path in sorted((FOLDER / "script").glob("*.js"))}
PAGE = (FOLDER / "index.html").read_text(encoding="utf-8")
DOOR = FOLDER.parent / "access" / "page"
CODE = (
    PAGE
    + "".join(SCRIPTS.values())
    + "".join(
        path.read_text(encoding="utf-8")
        for path in sorted(DOOR.rglob("*"))
        if path.suffix in (".js", ".html")
    )
)
KEY = r"[a-z]+(?:\.[a-z0-9_]+)+"


def without_comments(script: str) -> str:
    return re.sub(r"(?m)(^|[\s;{}])//.*$|/\*.*?\*/", r"\1", script, flags=re.DOTALL if "/*" in script else 0)


@pytest.mark.parametrize("language", get_args(Language))
def test_every_text_is_there_in_every_language(language):
    assert [key for key, texts in TEXTS.items() if not texts.get(language, "").strip()] == []


def test_there_are_no_other_languages_and_no_key_twice():
    assert {name for texts in TEXTS.values() for name in texts} == set(get_args(Language))
    lines = re.findall(
        r'^\s*"([^"]+)": \{', (FOLDER / "texts.json").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert len(lines) == len(set(lines)) == len(TEXTS)


def test_the_same_gaps_are_filled_in_every_language():
    for key, texts in TEXTS.items():
        gaps = {
            name: {field for _, field, _, _ in Formatter().parse(text) if field}
            for name, text in texts.items()
        }
        assert len({frozenset(found) for found in gaps.values()}) == 1, key


def test_every_key_that_is_asked_for_is_there():
    asked = set(re.findall(r'data-(?:text|label|title|hint)="([^"]+)"', PAGE))
    for script in SCRIPTS.values():
        asked |= set(re.findall(rf'\bt\("({KEY})"', script)) | set(
            re.findall(rf'"data-(?:text|label|title|hint)": "({KEY})"', script)
        )
    assert asked - set(TEXTS) == set()
    assert len(asked) > 60


def test_every_key_is_asked_for():
    families = set(re.findall(r"`([a-z]+\.(?:[a-z_]+\.)*[a-z_]*)\$\{", CODE)) | set(
        re.findall(r'"([a-z.]+\.)" \+', CODE)
    )
    unused = [
        key for key in TEXTS if f'"{key}"' not in CODE and not any(key.startswith(one) for one in families)
    ]
    assert unused == []


@pytest.mark.parametrize(
    ("family", "names"),
    [
        ("alarm.", AlarmSettings.model_fields),
        ("help.", AlarmSettings.model_fields),
        ("alarm.", get_args(AlarmState)),
        ("severity.", get_args(Severity)),
        ("camera.", get_args(CameraState)),
        ("standing.", STANDINGS),
        ("flow.trend_", get_args(Trend)),
        ("role.", ROLES),
        ("language.", get_args(Language)),
    ],
)
def test_what_the_program_may_say_has_its_word(family, names):
    assert [name for name in names if f"{family}{name}" not in TEXTS] == []


class Words(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_data(self, data: str) -> None:
        self.found += re.findall(r"[^\W\d_]{2,}", data)

    def handle_starttag(self, tag, attrs) -> None:
        self.found += [
            value or ""
            for name, value in attrs
            if name in ("title", "aria-label", "placeholder", "alt") and value
        ]


def test_no_words_in_the_html():
    words = Words()
    words.feed(PAGE)
    assert set(words.found) == {"Beltscape"}


@pytest.mark.parametrize("name", SCRIPTS)
def test_no_words_in_the_scripts(name):
    """Words are two or more in a row in a string that is no code: no selector, style, path, list of attributes."""
    strings = re.findall(r'"((?:[^"\\\n]|\\.)*)"', without_comments(re.sub(r"`[^`]*`", "", SCRIPTS[name])))
    spoken = [
        text
        for text in strings
        if re.search(r"[A-Za-z]{2,} [a-z]{2,}", text) and not re.search(r"[#\[\](){}<>:=/,-]|^\.", text)
    ]
    allowed = {"no WebGL", "webgl2", "high performance", "plain soft"}
    assert [text for text in spoken if text not in allowed and " WebGL" not in text] == []
