"""Numbers of JSON documents whose form pydantic checks: JSON has no NaN, so a number that is not known is null."""

from __future__ import annotations

from math import isfinite
from typing import Annotated

from pydantic import BeforeValidator


def _replace_nan(value: object) -> object:
    return None if isinstance(value, float) and not isfinite(value) else value


Number = Annotated[float | None, BeforeValidator(_replace_nan)]
"""A number; null where it is not known."""
