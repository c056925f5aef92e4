"""A message of the running system in English, with the parts from which a page composes it in another language."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

Value = float | int | str


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
