"""A message of the running system in English, with the parts from which a page composes it in another language.

The English text of each message stands once: under ``cause.KEY`` in the page's English file, as a sentence. So do
those of events whose text is the same in the history as on the page, under ``event.KEY``.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType

Value = float | int | str
LANGUAGES_FOLDER = Path(__file__).parents[1] / "data" / "web" / "languages"
"""One file of texts for each language of the page."""
_CAUSES, _EVENTS = "cause.", "event."
"""Families of keys."""


class Message(str):
    """A line of English text that also has the key of its text and the values in it."""

    key: str
    """Key of the text in the page's table; empty: it exists in English only."""
    values: Mapping[str, Value]
    """Values by the names of their placeholders."""

    def __new__(cls, text: str, key: str = "", **values: Value) -> Message:
        """Return the message ``text``; a page finds its translation by ``key`` and fills in ``values``."""
        message = super().__new__(cls, text)
        message.key, message.values = key, MappingProxyType(values)
        return message


def make_message(key: str, /, *, subject: str = "", detail: str = "", **values: Value) -> Message:
    """Return the message of a key with its values filled in; these are rounded to the digits to be shown.

    The English line begins with ``subject``, such as a camera, and ends with ``detail`` in brackets, such as what a
    driver answered. Pages show the subject in another place, and no detail.
    """
    line = _format_line(_CAUSES, key, values)
    start, end = f"{subject}: " if subject else "", f" ({detail})" if detail else ""
    return Message(f"{start}{line}{end}", key, **values)


def make_event_text(key: str, /, **values: Value) -> str:
    """Return the English line of an event's key with its values filled in."""
    return _format_line(_EVENTS, key, values)


def _format_line(family: str, key: str, values: Mapping[str, Value]) -> str:
    shown = {name: _format_value(value) for name, value in values.items()}
    return _read_lines()[family + key].format_map(shown)


def _format_value(value: Value) -> str:
    """Return a rounded value without the digits that a binary number adds."""
    return f"{value:.10g}" if isinstance(value, float) else str(value)


@cache
def _read_lines() -> dict[str, str]:
    """Return the English lines of both families by their keys."""
    import json

    texts: dict[str, str] = json.loads((LANGUAGES_FOLDER / "en.json").read_text(encoding="utf-8"))
    return {key: _to_line(text) for key, text in texts.items() if key.startswith((_CAUSES, _EVENTS))}


def _to_line(sentence: str) -> str:
    """Return a sentence as a part of a line: without the capital of its beginning and the full stop of its end."""
    return (sentence[:1].lower() + sentence[1:]).removesuffix(".")


def reword(message: str, text: str) -> str:
    """Return another text with the key and the values of a message; the text alone where it has no key."""
    return type(message)(text, message.key, **message.values) if isinstance(message, Message) else text


def attach_key(text: str, key: str, values: Mapping[str, Value]) -> str:
    """Return a text with the key and the values that it had; the text alone where the key is empty."""
    return Message(text, key, **values) if key else text


def get_key(text: str) -> str:
    """Return the key of a message; empty for a text that has none."""
    return text.key if isinstance(text, Message) else ""


def get_values(text: str) -> dict[str, Value]:
    """Return the values of a message; none for a text that has no key."""
    return dict(text.values) if isinstance(text, Message) else {}
