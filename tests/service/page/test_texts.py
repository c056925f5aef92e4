"""All texts of the page are in one file for each language, complete in every one."""

from __future__ import annotations

import ast
import json
import re
from html.parser import HTMLParser
from string import Formatter
from typing import get_args

import pytest

from beltscape.core.alarm_catalogue import CHECKS, DEFINITIONS, KINDS
from beltscape.core.alarms import AlarmState, Severity
from beltscape.core.events import CameraState
from beltscape.core.findings import EFFECTS
from beltscape.core.ledger import STANDINGS
from beltscape.core.translatable_message import LANGUAGES_FOLDER
from beltscape.measure.flow.encoder_check import Kind
from beltscape.metrology.certificate import APPLIES
from beltscape.service import settings
from beltscape.service.access.accounts import ROLES
from beltscape.service.settings import list_languages, read_texts
from beltscape.service.static import FOLDER
from beltscape.service.view_models import Trend

TEXTS = read_texts("en")
SCRIPTS = {path.name: path.read_text(encoding="utf-8") for path in sorted((FOLDER / "script").glob("*.js"))}
PAGE = (FOLDER / "index.html").read_text(encoding="utf-8")
ACCESS_PAGE = FOLDER.parent / "access" / "page"
SITE_PAGE = FOLDER.parents[1] / "site" / "page"
COMMISSION_PAGE = FOLDER.parents[1] / "commissioning" / "page"
CODE = (
    PAGE
    + "".join(SCRIPTS.values())
    + "".join(
        path.read_text(encoding="utf-8")
        for path in sorted([*ACCESS_PAGE.rglob("*"), *SITE_PAGE.rglob("*"), *COMMISSION_PAGE.rglob("*")])
        if path.suffix in (".js", ".html")
    )
)
SITE_CODE = [
    path.read_text(encoding="utf-8")
    for path in sorted([*SITE_PAGE.rglob("*.*"), *COMMISSION_PAGE.rglob("*.*")])
]
KEY = r"[a-z]+(?:\.[a-z0-9_]+)+"


def remove_comments(script: str) -> str:
    return re.sub(r"(?m)(^|[\s;{}])//.*$|/\*.*?\*/", r"\1", script, flags=re.DOTALL if "/*" in script else 0)


@pytest.mark.parametrize("language", list_languages(), ids=lambda language: language.code)
def test_every_language_has_the_same_keys_each_once_with_a_text(language):
    text = (LANGUAGES_FOLDER / f"{language.code}.json").read_text(encoding="utf-8")
    pairs: list[tuple[str, str]] = json.loads(text, object_pairs_hook=list)
    keys = [key for key, _ in pairs]
    assert len(keys) == len(set(keys))
    assert set(TEXTS) - set(keys) == set(), "missing"
    assert set(keys) - set(TEXTS) == set(), "unknown"
    assert [key for key, value in pairs if not value.strip()] == []


@pytest.mark.parametrize("language", list_languages(), ids=lambda language: language.code)
def test_placeholders_agree_in_every_language(language):
    for key, text in read_texts(language.code).items():
        assert list_placeholders(text) == list_placeholders(TEXTS[key]), key


def list_placeholders(text: str) -> set[str]:
    return {field for _, field, _, _ in Formatter().parse(text) if field}


def test_a_language_is_one_file_that_is_found_by_itself(tmp_path, monkeypatch):
    for file in LANGUAGES_FOLDER.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    header = {"language.name": "Latina", "language.locale": "la-VA", "language.tag": "la"}
    (tmp_path / "la.json").write_text(json.dumps({**TEXTS, **header}), encoding="utf-8")
    monkeypatch.setattr(settings, "LANGUAGES_FOLDER", tmp_path)
    list_languages.cache_clear()
    try:
        assert list_languages()[0].code == "en"
        assert settings.Language("la", "Latina", "la-VA", "la") in list_languages()
        assert settings.require_language("la") == "la"
    finally:
        list_languages.cache_clear()
    monkeypatch.undo()
    with pytest.raises(ValueError, match="no language 'la'; give one of en, de"):
        settings.require_language("la")


def test_every_used_key_exists():
    used = set(re.findall(r'data-(?:text|label|title|hint)="([^"]+)"', PAGE))
    for script in (*SCRIPTS.values(), *SITE_CODE):
        used |= set(re.findall(r'data-(?:text|label|title|hint)="([^"]+)"', script))
        used |= set(re.findall(rf'\bt\("({KEY})"', script)) | set(
            re.findall(rf'"data-(?:text|label|title|hint)": "({KEY})"', script)
        )
    assert used - set(TEXTS) == set()
    assert len(used) > 60


def test_every_key_is_used():
    families = set(re.findall(r"`([a-z]+\.(?:[a-z_]+\.)*[a-z_]*)\$\{", CODE)) | set(
        re.findall(r'"([a-z.]+\.)" \+', CODE)
    )
    unused = [
        key
        for key in TEXTS
        if f'"{key}"' not in CODE and not any(key.startswith(one) for one in (*families, "language."))
    ]
    assert unused == []


SOURCE = FOLDER.parents[1]


KEYS_OF = {
    "check": ("defocus", "condensation"),
    "f'projector_{state}' if check == PROJECTOR else check": (
        "projector_off", "projector_dim", "projector_focus", "dust",
    ),
    "f'zero_{kind}'": ("zero_moved", "zero_moved_on_one_side", "zero_film", "zero_worn"),
    "f'zero_set_{name}'": ("zero_set_rise", "zero_set_tilt"),
    "f'test_certificate_{found.changed[0]}'": tuple(f"test_certificate_{part}" for part in APPLIES),
    "f'encoder_{contradiction.kind}'": tuple(f"encoder_{kind}" for kind in get_args(Kind)),
}  # fmt: skip
"""Keys of messages that are composed, by their expression."""


def list_keys(expression: ast.expr, function: ast.FunctionDef) -> tuple[str, ...]:
    """Return the keys that the first argument of `make_message` may be."""
    if isinstance(expression, ast.Constant):
        return (str(expression.value),)
    if ast.unparse(expression) in KEYS_OF:
        return KEYS_OF[ast.unparse(expression)]
    if isinstance(expression, ast.IfExp):
        return (*list_keys(expression.body, function), *list_keys(expression.orelse, function))
    (value,) = (
        one.value
        for one in ast.walk(function)
        if isinstance(one, ast.Assign) and ast.unparse(one.targets[0]) == ast.unparse(expression)
    )
    return list_keys(value, function)


def find_messages() -> dict[str, set[str]]:
    """Return the keys of all messages in the source, with the names of their values."""
    messages: dict[str, set[str]] = {}
    for path in SOURCE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        nodes = ast.walk(ast.parse(text)) if "import make_message" in text else ()
        for function in [node for node in nodes if isinstance(node, ast.FunctionDef)]:
            for node in ast.walk(function):
                if isinstance(node, ast.Call) and ast.unparse(node.func) == "make_message":
                    names = {str(word.arg) for word in node.keywords} - {"subject", "detail"}
                    for key in list_keys(node.args[0], function):
                        assert messages.setdefault(key, names) == names, f"{path}:{node.lineno}"
    return messages


MESSAGES = find_messages()


def test_the_english_text_of_a_message_stands_in_the_file_of_texts_only():
    """Check that no module words a message, that all are in the file, and that it has no others."""
    worded = [
        str(path.relative_to(SOURCE))
        for path in SOURCE.rglob("*.py")
        if re.search(r"translatable_message import .*\bMessage\b", path.read_text(encoding="utf-8"))
    ]
    assert worded == []
    assert {key.removeprefix("cause.") for key in TEXTS if key.startswith("cause.")} == set(MESSAGES)


def test_the_history_words_events_by_the_file_of_texts():
    called = [
        node
        for path in SOURCE.rglob("*.py")
        if "import make_event_text" in (text := path.read_text(encoding="utf-8"))
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "make_event_text"
    ]
    assert len(called) >= 3
    for node in called:
        assert isinstance(node.args[0], ast.Constant)
        assert list_placeholders(TEXTS[f"event.{node.args[0].value}"]) == {
            str(one.arg) for one in node.keywords
        }


@pytest.mark.parametrize(("key", "names"), sorted(MESSAGES.items()))
def test_a_message_has_the_values_of_its_text_and_is_one_sentence(key, names):
    text = TEXTS[f"cause.{key}"]
    assert {field for _, field, _, _ in Formatter().parse(text) if field} == names
    assert re.search(r"\.\s", text) is None
    assert text.endswith((".", "?"))


def test_every_fault_of_a_check_is_a_message():
    """Check that what makes a finding's text, in the checks' own modules, is a message with a key."""
    modules = [*(SOURCE / "health").rglob("*.py"), *(SOURCE / "stereo" / "consistency").rglob("*.py")]
    for path in [*modules, SOURCE / "measure" / "flow" / "encoder_check.py"]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.FunctionDef):
                continue
            words = {
                word.arg for call in ast.walk(node) if isinstance(call, ast.Call) for word in call.keywords
            }
            makes = (
                any(isinstance(one, ast.Name) and one.id == "text" for one in ast.walk(node))
                or "text" in words
            )
            is_composed = any(isinstance(one, ast.JoinedStr) for one in ast.walk(node))
            if makes and is_composed and node.name not in ("_describe_residuals",):
                assert "make_message(" in ast.unparse(node), f"{path.name}: {node.name}"


@pytest.mark.parametrize(
    ("family", "names"),
    [
        ("health.", (*EFFECTS[1:], "ok", "unknown", "fault")),
        ("severity.", get_args(Severity)),
        ("camera.", get_args(CameraState)),
        ("standing.", STANDINGS),
        ("flow.trend_", get_args(Trend)),
        ("role.", ROLES),
    ],
)
def test_every_value_of_the_program_has_a_text(family, names):
    assert [name for name in names if f"{family}{name}" not in TEXTS] == []


@pytest.mark.parametrize(
    ("family", "names"),
    [("alarm.", (*KINDS, *get_args(AlarmState))), ("check.", CHECKS), ("help.", DEFINITIONS)],
)
def test_texts_of_alarms_are_those_of_the_catalogue(family, names):
    assert {key.removeprefix(family) for key in TEXTS if key.startswith(family)} == set(names)


class TextParser(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.words: list[str] = []

    def handle_data(self, data: str) -> None:
        self.words += re.findall(r"[^\W\d_]{2,}", data)

    def handle_starttag(self, tag, attrs) -> None:
        self.words += [
            value or ""
            for name, value in attrs
            if name in ("title", "aria-label", "placeholder", "alt") and value
        ]


def test_html_contains_no_text():
    parser = TextParser()
    parser.feed(PAGE)
    assert set(parser.words) == {"Beltscape"}


@pytest.mark.parametrize("name", SCRIPTS)
def test_scripts_contain_no_text(name):
    """Check that no string outside code (selectors, styles, paths, attributes) has two or more words in a row."""
    strings = re.findall(r'"((?:[^"\\\n]|\\.)*)"', remove_comments(re.sub(r"`[^`]*`", "", SCRIPTS[name])))
    texts = [
        text
        for text in strings
        if re.search(r"[A-Za-z]{2,} [a-z]{2,}", text) and not re.search(r"[#\[\](){}<>:=/,-]|^\.", text)
    ]
    allowed = {"no WebGL", "webgl2", "high performance", "plain soft", "plain main", "plain small"}
    assert [text for text in texts if text not in allowed and " WebGL" not in text] == []
