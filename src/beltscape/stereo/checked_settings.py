"""Validation of settings that Python callers make; an invalid value raises a SettingsError of one line."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ModelWrapValidatorHandler, ValidationError, model_validator

from beltscape.core.checks import show_value
from beltscape.core.errors import SettingsError, suggest_name
from beltscape.files.documents.toml_text import describe_first_error


class CheckedSettings(BaseModel):
    """Immutable settings without unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="wrap")
    @classmethod
    def _validate(cls, values: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Validate, or raise a SettingsError that names the setting, its value and the allowed ones."""
        try:
            return handler(values)
        except ValidationError as error:
            raise SettingsError(f"{cls.__name__}: {describe_first_error(cls, error)}") from error

    def revalidate(self) -> Self:
        """Return the same settings, validated anew: ``model_copy(update=…)`` does not validate."""
        return type(self).model_validate(dict(self.__dict__))


def require_preset(name: Any, presets: Iterable[str]) -> str:
    """Return the name of a preset; raise a SettingsError that lists the presets for any other."""
    names = list(presets)
    if isinstance(name, str) and name in names:
        return name
    fix = suggest_name(str(name), names) or f"there are {', '.join(names)}"
    raise SettingsError(f"preset = {show_value(name)} is not known; {fix}")
