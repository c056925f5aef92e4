"""Reading TOML into a settings model, with one clear line where something does not fit."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from beltscape.core.errors import InputError
from beltscape.files.documents.plain_text import read_text

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

    Model = TypeVar("Model", bound=BaseModel)


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file, or InputError naming the place."""
    try:
        return tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not TOML ({error})") from error


def validated(path: Path, model: type[Model], values: dict[str, Any]) -> Model:
    """``values`` as ``model``, or InputError with the first thing that does not fit, in words."""
    from pydantic import ValidationError

    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise InputError(f"{path}: {first_problem(model, error)}") from error


def first_problem(model: type[BaseModel], error: ValidationError) -> str:
    """Return the first thing that does not fit a model, in words."""
    # a misspelt key is also a missing one: the misspelling comes first
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    return _in_words(first, _known(model, first["loc"]))


def _known(model: type[BaseModel], place: tuple[int | str, ...]) -> list[str]:
    """The keys of the table in which ``place`` names one; empty where that is no table of a fixed form."""
    from pydantic import BaseModel

    tables: list[Any] = [model]
    for part in place[:-1]:
        if isinstance(part, str):
            inside = [t.model_fields[part].annotation for t in tables if part in t.model_fields]
            tables = [t for each in inside for t in _models(each, BaseModel)]
    return [key for table in tables for key in table.model_fields]


def _models(annotation: Any, base: type) -> list[Any]:
    """The models that a field may hold: itself, or among its alternatives or elements."""
    from typing import get_args

    if isinstance(annotation, type) and issubclass(annotation, base):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models(argument, base)]


def _in_words(error: Any, known: list[str]) -> str:
    """One of pydantic's errors as one would say it."""
    from difflib import get_close_matches

    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in error["loc"])[1:]
    if error["type"] == "extra_forbidden":
        near = get_close_matches(str(error["loc"][-1]), known, n=1)
        return f"unknown key {key}; " + (f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}")
    if error["type"] == "missing":
        return f"{key} is missing"
    if error["type"] == "value_error":
        text = str(error["ctx"]["error"])
        return f"{key} = {error['input']!r}: {text}" if key else text
    if error["type"] == "tuple_type":
        text = "must be a list"
    elif error["type"] == "too_short":
        text = f"must have at least {error['ctx']['min_length']} values"
    elif error["type"] == "too_long":
        text = f"must have {error['ctx']['max_length']} values, not {error['ctx']['actual_length']}"
    else:
        text = error["msg"].replace("Input should", "must", 1)
    return f"{key} = {error['input']!r}: {text}"
