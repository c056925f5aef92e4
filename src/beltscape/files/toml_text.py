"""Reading TOML into a settings model, with one clear line where something does not fit."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from beltscape.core.errors import InputError

if TYPE_CHECKING:
    from pydantic import BaseModel

    Model = TypeVar("Model", bound=BaseModel)


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file, or InputError naming the place."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not TOML ({error})") from error


def validated(path: Path, model: type[Model], values: dict[str, Any]) -> Model:
    """``values`` as ``model``, or InputError with the first thing that does not fit, in words."""
    from difflib import get_close_matches

    from pydantic import ValidationError

    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "file"
        if first["type"] == "extra_forbidden":
            near = get_close_matches(key, list(model.model_fields), n=1)
            hint = f"; did you mean {near[0]}?" if near else f"; known: {', '.join(model.model_fields)}"
            raise InputError(f"{path}: unknown key {key}{hint}") from error
        value = "" if first["type"] == "missing" else f" = {first['input']!r}"
        raise InputError(f"{path}: {key}{value}: {first['msg'][:1].lower()}{first['msg'][1:]}") from error
