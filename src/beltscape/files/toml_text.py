"""Reading of TOML into settings models, with errors in one line."""

from __future__ import annotations

import json
import operator
import re
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from beltscape.core.checks import is_list_or_tuple, show_value
from beltscape.core.errors import InputError, suggest_name
from beltscape.core.quantities import find_unit, suggest_unit
from beltscape.files.paths import parse_decimal, read_text

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
    """Return ``values`` as ``model``; InputError with the first invalid key. Unusual values are reported."""
    from pydantic import ValidationError

    def describe_oddity(key: str, value: float, oddity: str) -> str:
        return f"{path}: {key} = {value:g}: {oddity}"

    try:
        return validate_strictly(model, values, describe_oddity)
    except ValidationError as error:
        raise InputError(f"{path}: {describe_first_error(model, error)}") from error


def validate_strictly(
    model: type[Model], values: Mapping[str, object], describe_oddity: Callable[[str, float, str], str]
) -> Model:
    """Return ``values`` as ``model``, without taking texts or truth values as numbers; pydantic's ValidationError.

    They are validated as JSON: strictly, Python's lists would be no tuples, and texts no paths.
    """
    text = json.dumps(dict(values), default=_to_json)
    return model.model_validate_json(text, strict=True, context=describe_oddity)


def _to_json(value: Any) -> Any:
    """Return a path, a NumPy number or array for JSON; all else becomes a table, which no setting takes instead."""
    if isinstance(value, Path):
        return str(value)
    return value.tolist() if hasattr(value, "tolist") else {type(value).__name__: str(value)}


def describe_first_error(model: type[BaseModel], error: ValidationError) -> str:
    """Return a readable description of the first error."""
    # a misspelt key is also a missing one: the misspelling comes first
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    if first["type"] == "extra_forbidden":
        return _describe_unknown_key(model, first["loc"])
    return _describe_error(first)


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


def _describe_unknown_key(model: type[BaseModel], place: tuple[int | str, ...]) -> str:
    """Return the unknown key with the similar one of its table, the other table that has it, or the known keys."""
    name, known = str(place[-1]), _known_keys(model, place)
    fix = suggest_name(name, known)
    if not fix and len(place) > 1:
        others = [table for table in model.model_fields if name in _known_keys(model, (table, name))]
        fix = f"it is a key of [{'] and ['.join(others)}]" if others else ""
    return f"unknown key {_join(place)}; " + (fix or f"known: {', '.join(known)}")


_WORDS: Mapping[str, str] = {
    **dict.fromkeys(("float_type", "float_parsing"), "must be a number"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "must be a whole number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "must be true or false"),
    **dict.fromkeys(("string_type", "path_type"), "must be a text, in quotation marks"),
    **dict.fromkeys(("model_type", "model_attributes_type", "dict_type", "mapping_type"), "must be a table"),
    **dict.fromkeys(("tuple_type", "list_type"), "must be a list"),
    "date_type": "must be a date",
}
"""By pydantic's type of error: what a value must be."""
_BOUNDS: Mapping[str, Callable[[float, float], bool]] = {
    "greater_than": operator.gt, "greater_than_equal": operator.ge, "less_than": operator.lt,
    "less_than_equal": operator.le,
}  # fmt: skip
"""By pydantic's type of error: the comparison that a number must fulfil."""


def _describe_error(error: Any) -> str:
    """Return key, value and fault of one of pydantic's errors."""
    key = _join(error["loc"])
    if error["type"] == "missing":
        return f"{key} is missing"
    text = describe_fault(error)
    return f"{key} = {_show(error['input'])}: {text}" if key else text


def describe_fault(error: Any) -> str:
    """Return what one of pydantic's errors says of its value, with the unit that a number was probably given in."""
    kind, value = error["type"], error["input"]
    if kind == "value_error":
        return str(error["ctx"]["error"])
    if kind == "too_short":
        text = f"must have at least {error['ctx']['min_length']} values"
    elif kind == "too_long":
        text = f"must have {error['ctx']['max_length']} values, not {error['ctx']['actual_length']}"
    elif kind in _WORDS:
        is_quoted = (
            kind in ("float_type", "int_type") and isinstance(value, str) and parse_decimal(value) is not None
        )
        text = _WORDS[kind] + (", without quotation marks" if is_quoted else "")
    else:
        text = re.sub(r"^(Input|String|List|Tuple|Dictionary) should", "must", error["msg"])
    if kind in _BOUNDS and isinstance(value, int | float):
        text += suggest_unit(value, _find_unit_of(error["loc"]), _make_fit(error))
    return text


def _make_fit(error: Any) -> Callable[[float], bool]:
    """Return what tells whether a number fulfils the bound that an error is about."""
    compare, (bound,) = _BOUNDS[error["type"]], error["ctx"].values()
    return lambda converted: compare(converted, bound)


def _find_unit_of(place: tuple[int | str, ...]) -> str:
    """Return the unit in the name of the last key of a place."""
    return next((find_unit(part) for part in reversed(place) if isinstance(part, str)), "")


def _join(place: tuple[int | str, ...]) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).removeprefix(".")


def _show(value: Any) -> str:
    """Return a value as TOML and JSON write it."""
    if isinstance(value, bool):
        return str(value).lower()
    if is_list_or_tuple(value):
        return f"[{', '.join(map(_show, value))}]"
    return "null" if value is None else show_value(value)
