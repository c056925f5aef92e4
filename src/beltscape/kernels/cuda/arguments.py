"""What a recorded function is given and returns: records, lists and mappings with arrays and numbers in them.

`describe` returns what a graph is found again by, and collects the arrays and the numbers that may differ from call
to call. `rebuild` returns the same records with others in their places. Both go through the records in the same
order.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from copy import copy
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, Literal

import numpy as np

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
    """Return the key of a value, and add its arrays and numbers to ``given``."""
    if isinstance(value, ResidentArray | np.ndarray):
        return _describe_array(value, given)
    if value is None or isinstance(value, int | float | str | np.generic):
        return type(value), value
    if isinstance(value, KernelFamily):
        given.kernels.append(value)
        return type(value)
    if isinstance(value, _SEQUENCES):
        return type(value), *(describe(each, given) for each in value)
    if isinstance(value, Mapping):
        return type(value), *((name, describe(each, given)) for name, each in value.items())
    if is_dataclass(value) and not isinstance(value, Rig | type):
        return type(value), *(_describe_field(value, each.name, given) for each in fields(value))
    given.retained.append(value)
    return type(value), id(value)


def _describe_array(array: Any, given: Given) -> Hashable:
    if isinstance(array, np.ndarray) and array.nbytes <= MOST_FIXED_BYTES:
        return array.dtype.str, array.shape, array.tobytes()
    given.arrays.append(array)
    return array.dtype.str, array.shape


def _is_number(value: Any) -> bool:
    """Return whether a record's value is a number, one on the device, or the slot of one."""
    if isinstance(value, ResidentArray):
        return value.shape == ()
    return isinstance(value, float) or (isinstance(value, Slot) and value.kind == "number")


def _describe_field(record: Any, name: str, given: Given) -> Hashable:
    value = getattr(record, name)
    if isinstance(record, FrameNumbers) and _is_number(value):
        given.numbers.append(value)
        return "a number"
    return describe(value, given)


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


def fill(value: Any, replace: Callable[[Slot], Any]) -> Any:
    """Return a value with something in its slots."""

    def number(slot: Any) -> Any:
        return replace(slot) if isinstance(slot, Slot) else slot  # one that is the same for every frame

    return rebuild(value, Replacements(replace, number, replace))


def rebuild(value: Any, replace: Replacements) -> Any:
    """Return a value with others in the places of its arrays, numbers and kernels, or in its slots."""
    if isinstance(value, Slot):
        return replace.array(value)
    if isinstance(value, np.ndarray) and value.nbytes <= MOST_FIXED_BYTES:
        return value
    if isinstance(value, ResidentArray | np.ndarray):
        return replace.array(value)
    if isinstance(value, KernelFamily):
        return replace.kernels(value)
    if isinstance(value, _SEQUENCES):
        parts = [rebuild(each, replace) for each in value]
        return type(value)(*parts) if hasattr(value, "_fields") else type(value)(parts)
    if isinstance(value, Mapping):
        return {name: rebuild(each, replace) for name, each in value.items()}
    if is_dataclass(value) and not isinstance(value, Rig | type):
        return _rebuild_record(value, replace)
    return value


def _rebuild_record(record: Any, replace: Replacements) -> Any:
    """Return a copy of a record; nothing that it derives from its fields is computed anew."""
    changed = copy(record)
    for each in fields(record):
        value = getattr(record, each.name)
        if isinstance(record, FrameNumbers) and _is_number(value):
            new = replace.number(value)
        else:
            new = rebuild(value, replace)
        object.__setattr__(changed, each.name, new)
    return changed
