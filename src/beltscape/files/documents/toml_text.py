"""Reading of TOML into settings models, with errors in one line."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from beltscape.core.checks import show_value
from beltscape.core.errors import InputError
from beltscape.files.documents.plain_text import read_text

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

    Model = TypeVar("Model", bound=BaseModel)


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file; InputError with the position if it is invalid."""
    try:
        return tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not TOML ({error})") from error


def validate(path: Path, model: type[Model], values: dict[str, Any]) -> Model:
    """Return ``values`` as ``model``; InputError with the first invalid key."""
    from pydantic import ValidationError

    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise InputError(f"{path}: {describe_first_error(model, error)}") from error


def describe_first_error(model: type[BaseModel], error: ValidationError) -> str:
    """Return a readable description of the first error."""
    # a misspelt key is also a missing one: the misspelling comes first
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    return _describe_error(first, _known_keys(model, first["loc"]))


def _known_keys(model: type[BaseModel], place: tuple[int | str, ...]) -> list[str]:
    """Return the keys of the table that ``place`` lies in; empty if that table has no fixed keys."""
    from pydantic import BaseModel

    tables: list[Any] = [model]
    for part in place[:-1]:
        if isinstance(part, str):
            inside = [t.model_fields[part].annotation for t in tables if part in t.model_fields]
            tables = [t for each in inside for t in _models(each, BaseModel)]
    return [key for table in tables for key in table.model_fields]


def _models(annotation: Any, base: type) -> list[Any]:
    """Return the models that a field may hold: itself, or among its alternatives or elements."""
    from typing import get_args

    if isinstance(annotation, type) and issubclass(annotation, base):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models(argument, base)]


def _describe_error(error: Any, known: list[str]) -> str:
    """Return a readable description of one of pydantic's errors."""
    from difflib import get_close_matches

    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in error["loc"])[1:]
    if error["type"] == "extra_forbidden":
        near = get_close_matches(str(error["loc"][-1]), known, n=1)
        return f"unknown key {key}; " + (f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}")
    if error["type"] == "missing":
        return f"{key} is missing"
    if error["type"] == "value_error":
        text = str(error["ctx"]["error"])
        return f"{key} = {show_value(error['input'])}: {text}" if key else text
    if error["type"] == "tuple_type":
        text = "must be a list"
    elif error["type"] == "too_short":
        text = f"must have at least {error['ctx']['min_length']} values"
    elif error["type"] == "too_long":
        text = f"must have {error['ctx']['max_length']} values, not {error['ctx']['actual_length']}"
    else:
        text = error["msg"].replace("Input should", "must", 1)
    return f"{key} = {show_value(error['input'])}: {text}"
