"""What a recorded function is given and returns: records, lists and mappings with arrays and numbers in them.

`describe` returns what a graph is found again by, and collects the arrays and the numbers that may differ from call
to call. `rebuild` returns the same records with others in their places. Both go through the records in the same
order.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.rig import Rig
from beltscape.kernels.backend import FrameNumbers, KernelFamily
from beltscape.kernels.resident import ResidentArray

MOST_FIXED_BYTES = 4096
"""Of an array of the processor whose content is part of the key, such as projections; larger ones are given."""

_SEQUENCES: tuple[type, ...] = list, tuple
SlotKind = Literal["computed", "argument", "number", "kernels"]


@dataclass
class Given:
    """What may differ from call to call."""

    arrays: list[Any] = field(default_factory=list)
    """Arrays of the device, and large ones of the processor."""
    numbers: list[Any] = field(default_factory=list)
    """Floats of records of `beltscape.kernels.backend.FrameNumbers`."""
    kernels: list[Any] = field(default_factory=list)
    retained: list[Any] = field(default_factory=list)
    """Objects that the key knows by their identity: they must live as long as the key."""


def describe(value: Any, given: Given) -> Hashable:
    """Return the key of a value, and add its arrays and numbers to ``given``.

    A frame describes some 1,500 values: what is to be done with each is looked up by its type.
    """
    return _find_describer(type(value))(value, given)


Describer = Callable[[Any, Given], Hashable]


@cache
def _find_describer(kind: type) -> Describer:
    """Return what describes the values of a type."""
    if issubclass(kind, ResidentArray):
        return _describe_resident
    if issubclass(kind, np.ndarray):
        return _describe_array
    if issubclass(kind, type(None) | int | float | str | np.generic):
        return lambda value, _: (kind, value)
    if issubclass(kind, KernelFamily):
        return _describe_kernels
    if issubclass(kind, _SEQUENCES):
        return lambda value, given: (kind, *[_find_describer(type(each))(each, given) for each in value])
    if issubclass(kind, Mapping):
        return lambda value, given: (kind, *[(name, describe(each, given)) for name, each in value.items()])
    if _is_record(kind):
        return _make_record_describer(kind)
    return _describe_object


def _describe_array(array: NDArray[Any], given: Given) -> Hashable:
    if array.nbytes <= MOST_FIXED_BYTES:
        return array.dtype, array.shape, array.tobytes()
    given.arrays.append(array)
    return array.dtype, array.shape


def _describe_resident(array: ResidentArray, given: Given) -> Hashable:
    given.arrays.append(array)
    return array.dtype, array.shape


def _describe_kernels(value: KernelFamily, given: Given) -> Hashable:
    given.kernels.append(value)
    return type(value)


def _describe_object(value: Any, given: Given) -> Hashable:
    given.retained.append(value)
    return type(value), id(value)


def _make_record_describer(kind: type) -> Describer:
    names, has_numbers = _list_fields(kind), issubclass(kind, FrameNumbers)

    def describe_record(record: Any, given: Given) -> Hashable:
        parts: list[Hashable] = [kind]
        for name in names:
            value = getattr(record, name)
            if has_numbers and _is_number(value):
                given.numbers.append(value)
                parts.append("a number")
            else:
                parts.append(_find_describer(type(value))(value, given))
        return tuple(parts)

    return describe_record


@cache
def _list_fields(kind: type) -> tuple[str, ...]:
    return tuple(each.name for each in fields(kind))


@cache
def _is_record(kind: type) -> bool:
    return is_dataclass(kind) and not issubclass(kind, Rig)


def _is_number(value: Any) -> bool:
    """Return whether a record's value is a number, one on the device, or the slot of one."""
    if isinstance(value, ResidentArray):
        return value.shape == ()
    return isinstance(value, float) or (isinstance(value, Slot) and value.kind == "number")


class Slot:
    """The place of an array, a number or kernels in the result of a recorded function."""

    __slots__ = ("index", "kind", "reference")

    def __init__(self, kind: SlotKind, index: int = 0, reference: Any = None) -> None:
        self.kind: SlotKind = kind
        self.index = index
        """Of the argument, or of the number."""
        self.reference = reference
        """To the array; of an argument's None where it is all of it."""


@dataclass(frozen=True)
class Replacements:
    """What `rebuild` puts in the places of arrays, numbers and kernels; each is called in the order of `describe`."""

    array: Callable[[Any], Any]
    number: Callable[[Any], Any]
    kernels: Callable[[Any], Any]
    fixed: frozenset[int] = frozenset()
    """``id`` of parts that stay as they are."""


def fill(value: Any, replace: Callable[[Slot], Any], fixed: frozenset[int] = frozenset()) -> Any:
    """Return a value with something in its slots; parts whose ``id`` is among the fixed ones have none."""

    def number(slot: Any) -> Any:
        return replace(slot) if isinstance(slot, Slot) else slot  # one that is the same for every frame

    return rebuild(value, Replacements(replace, number, replace, fixed))


def find_fixed(value: Any, found: set[int]) -> bool:
    """Return whether a value has no slot, and add the ``id`` of its parts that have none."""
    if isinstance(value, Slot):
        return False
    parts: list[Any] = []
    if isinstance(value, _SEQUENCES):
        parts = list(value)
    elif isinstance(value, Mapping):
        parts = list(value.values())
    elif _is_record(type(value)):
        parts = [getattr(value, name) for name in _list_fields(type(value))]
    are_fixed = [find_fixed(each, found) for each in parts]
    if all(are_fixed):
        found.add(id(value))
    return all(are_fixed)


def rebuild(value: Any, replace: Replacements) -> Any:
    """Return a value with others in the places of its arrays, numbers and kernels, or in its slots."""
    kind = type(value)
    if kind is Slot:
        return replace.array(value)
    if id(value) in replace.fixed:
        return value
    return _find_rebuilder(kind)(value, replace)


Rebuilder = Callable[[Any, Replacements], Any]


@cache
def _find_rebuilder(kind: type) -> Rebuilder:
    """Return what rebuilds the values of a type."""
    if issubclass(kind, np.ndarray):
        return lambda value, replace: value if value.nbytes <= MOST_FIXED_BYTES else replace.array(value)
    if issubclass(kind, ResidentArray):
        return lambda value, replace: replace.array(value)
    if issubclass(kind, KernelFamily):
        return lambda value, replace: replace.kernels(value)
    if issubclass(kind, _SEQUENCES):
        is_named = hasattr(kind, "_fields")

        def rebuild_sequence(value: Any, replace: Replacements) -> Any:
            parts = [rebuild(each, replace) for each in value]
            return kind(*parts) if is_named else kind(parts)

        return rebuild_sequence
    if issubclass(kind, Mapping):
        return lambda value, replace: {name: rebuild(each, replace) for name, each in value.items()}
    return _rebuild_record if _is_record(kind) else lambda value, _: value


def _rebuild_record(record: Any, replace: Replacements) -> Any:
    """Return a copy of a record; nothing that it derives from its fields is computed anew."""
    kind: Any = type(record)
    changed, has_numbers = object.__new__(kind), issubclass(kind, FrameNumbers)
    if hasattr(record, "__dict__"):
        changed.__dict__.update(record.__dict__)
    for name in _list_fields(kind):
        value = getattr(record, name)
        new = replace.number(value) if has_numbers and _is_number(value) else rebuild(value, replace)
        object.__setattr__(changed, name, new)
    return changed
