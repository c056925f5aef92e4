"""Where the arrays of a recorded stretch lie in a graph's memory.

Arguments and results have places of their own, which nothing else overwrites. An intermediate result has a place from
its first launch to its last; the same place serves others before and after.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from beltscape.kernels.cuda.recording import ArrayReference, LaunchList

_ALIGNMENT = 256
"""Bytes of which every array's address is a multiple: as a GPU's own allocations."""


@dataclass(frozen=True)
class Storage:
    """The places of a recording's arrays."""

    scratch_bytes: int
    """Of all intermediate results."""
    scratch: dict[int, int]
    """Block of an intermediate result → its first byte."""
    outputs: dict[int, int]
    """Block that holds results → its bytes."""
    used_inputs: list[bool]
    """Of each argument, whether a launch reads it."""
    tables: dict[int, int]
    """Block of a table of addresses → its first element in the table of all."""
    table_items: int


@dataclass(frozen=True)
class RecordedFunction:
    """A recorded function."""

    recording: LaunchList
    inputs: list[ArrayReference]
    """The arrays that it was given."""
    numbers: ArrayReference
    """(n,) the numbers that it was given."""
    result: Any
    """What it returned, with a slot in the place of every array, number and kernels."""
    retained: list[Any]
    """See `beltscape.kernels.cuda.arguments.Given`."""
    storage: Storage
    fixed: frozenset[int]
    """``id`` of the parts of the result without a slot, see `beltscape.kernels.cuda.arguments.find_fixed`."""


def plan_storage(
    recording: LaunchList, inputs: Sequence[ArrayReference], outputs: Iterable[ArrayReference]
) -> Storage:
    """Return the places of a recording's arrays; those of ``outputs`` are its results."""
    retained = {each.serial: recording.sizes[each.serial] for each in outputs}
    lives: dict[int, tuple[int, int]] = {}
    used = [False] * len(inputs)
    for number, launch in enumerate(recording.launches):
        for reference in recording.list_references(launch):
            index = find_input(inputs, reference)
            if index is not None:
                used[index] = True
            elif reference.serial in recording.sizes and reference.serial not in recording.constants:
                first, _ = lives.get(reference.serial, (number, number))
                lives[reference.serial] = first, number
    tables, items = dict[int, int](), 0
    for serial, references in recording.tables.items():
        tables[serial], items = items, items + len(references)
    lives = {
        serial: life for serial, life in lives.items() if serial not in retained and serial not in tables
    }
    places, size = place_in_turn(lives, recording.sizes)
    return Storage(size, places, retained, used, tables, items)


def place_in_turn(lives: dict[int, tuple[int, int]], sizes: dict[int, int]) -> tuple[dict[int, int], int]:
    """Return the first byte of each array (first and last launch by its block), and the bytes of all.

    Large arrays are placed first; each takes the lowest place that no other has at the same time.
    """
    placed: list[tuple[int, int, int, int]] = []
    places: dict[int, int] = {}
    for serial in sorted(lives, key=lambda each: (-sizes[each], each)):
        (first, last), size = lives[serial], align(sizes[serial])
        at = 0
        for begin, end, since, until in sorted(placed):
            if until < first or since > last:
                continue
            if begin - at >= size:
                break
            at = max(at, end)
        places[serial] = at
        placed.append((at, at + size, first, last))
    return places, max((end for _, end, _, _ in placed), default=0)


def find_input(inputs: Sequence[ArrayReference], reference: ArrayReference) -> int | None:
    """Return which argument an array is part of; None for none."""
    for index, each in enumerate(inputs):
        if each.serial == reference.serial and each.offset <= reference.offset < each.offset + max(
            1, each.nbytes
        ):
            return index
    return None


def align(size: int) -> int:
    """Return the bytes that an array takes up."""
    return -(-max(1, size) // _ALIGNMENT) * _ALIGNMENT
