"""Checks of the values that types and functions get: numbers, texts, arrays. Errors name the argument.

Type guards tell the type of values that is known only at run time: parsed documents, arguments of Python callers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any, TypeGuard

from beltscape.core.errors import ArgumentError

if TYPE_CHECKING:
    from numpy.typing import NDArray


def is_dict(value: object) -> TypeGuard[dict[str, Any]]:
    """Return whether a value is a dict; a parsed document's keys are text."""
    return isinstance(value, dict)


def is_mapping(value: object) -> TypeGuard[Mapping[str, Any]]:
    """Return whether a value is a mapping; its keys are taken to be text."""
    return isinstance(value, Mapping)


def is_list(value: object) -> TypeGuard[list[Any]]:
    """Return whether a value is a list."""
    return isinstance(value, list)


def is_list_or_tuple(value: object) -> TypeGuard[list[Any] | tuple[Any, ...]]:
    """Return whether a value is a list or a tuple."""
    return isinstance(value, (list, tuple))


_MOST_SHOWN = 60
"""Characters of a value that an error shows: it names the value, and the line stays readable."""


def require_instance(value: Any, kind: type, argument: str, source: str) -> None:
    """Raise ArgumentError unless ``value`` is a ``kind``; ``source`` is the call that gives one."""
    if not isinstance(value, kind):
        raise ArgumentError(f"{argument} is {describe_kind(value)}: must be a {kind.__name__}, from {source}")


def require_number(value: Any, argument: str, least: float = -math.inf, *, above: bool = False) -> None:
    """Raise ArgumentError unless ``value`` is a finite number from ``least`` on; ``above``: and not equal to it."""
    bound = "" if least == -math.inf else f" {'above' if above else 'of at least'} {least:g}"
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ArgumentError(f"{argument} = {show_value(value)}: must be a number{bound}")
    if not math.isfinite(value) or value < least or (above and value == least):
        raise ArgumentError(f"{argument} = {show_value(value)}: must be a finite number{bound}")


def require_text(value: Any, argument: str) -> None:
    """Raise ArgumentError unless ``value`` is a text; a camera that is alone needs no name, so it may be empty."""
    if not isinstance(value, str):
        raise ArgumentError(f"{argument} = {show_value(value)}: must be a text")


def require_pair(value: Any, argument: str) -> None:
    """Raise ArgumentError unless ``value`` is two finite numbers, the first below the second."""
    if not is_list_or_tuple(value) or len(value) != 2:
        raise ArgumentError(f"{argument} = {show_value(value)}: must be two numbers, (from, to)")
    for one in value:
        require_number(one, argument)
    if not value[0] < value[1]:
        raise ArgumentError(f"{argument} = {show_value(value)}: must be (from, to), the smaller number first")


def require_array(value: Any, argument: str, shape: tuple[int | None, ...]) -> None:
    """Raise ArgumentError unless ``value`` is an array of numbers of this shape; None: any length."""
    if not is_array(value):
        raise ArgumentError(
            f"{argument} is {describe_kind(value)}: must be a NumPy array, such as np.array(...)"
        )
    if value.dtype.kind not in "fiu":
        raise ArgumentError(f"{argument} is an array of {value.dtype}: must be of numbers")
    fits = value.shape == shape or (
        value.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, value.shape, strict=True))
    )
    if not fits:
        wanted = (
            "(" + ", ".join("n" if n is None else str(n) for n in shape) + ("," * (len(shape) == 1)) + ")"
        )
        raise ArgumentError(f"{argument} has the shape {value.shape}: must be {wanted}")


def require_like(value: Any, argument: str, other: NDArray[Any], named: str) -> None:
    """Raise ArgumentError unless ``value`` is an array of numbers of the shape of another argument."""
    if is_array(value) and value.shape != other.shape:
        raise ArgumentError(
            f"{argument} has the shape {value.shape}, {named} {other.shape}: they must be the same"
        )
    require_array(value, argument, other.shape)


def is_array(value: Any) -> TypeGuard[NDArray[Any]]:
    """Return whether a value is an array."""
    import numpy as np  # only here: the command line's help checks paths, and loads no numpy

    return isinstance(value, np.ndarray)


def describe_kind(value: Any) -> str:
    """Return the kind of a value as errors name it."""
    return "None" if value is None else f"a {type(value).__name__}"


def require_reporter(value: Any) -> None:
    """Raise ArgumentError unless ``value`` is None or has the methods of a reporter."""
    if value is not None and not all(callable(getattr(value, name, None)) for name in ("step", "warn")):
        raise ArgumentError(f"reporter is {describe_kind(value)}: must have the methods step and warn")


def require_choice(value: Any, argument: str, choices: Sequence[str | None]) -> None:
    """Raise ArgumentError unless ``value`` is one of the choices."""
    if not (value is None or isinstance(value, str)) or value not in choices:
        raise ArgumentError(
            f"{argument} = {show_value(value)}: must be one of {', '.join(map(repr, choices))}"
        )


def show_value(value: object) -> str:
    """Return a value as errors show it: in one line that is not long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}…"
