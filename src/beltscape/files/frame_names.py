"""Names of frames: their natural order, and the common names of cameras that name the same instants differently."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from beltscape.core.errors import InputError

Item = TypeVar("Item")

_DIGITS = re.compile(r"([0-9]+)")
_FIX = "give the images of one instant the same name in every camera's folder"


def natural_key(name: str) -> tuple[tuple[int, int | str], ...]:
    """Return a sort key that puts cal2 before cal10."""
    parts: list[tuple[int, int | str]] = []
    for place, part in enumerate(_DIGITS.split(name)):
        parts += [(0, int(part))] if place % 2 else [(1, char) for char in part]
    return (*parts, (1, ""), (2, name))


def sort_frames(files: Iterable[Iterable[str]]) -> tuple[str, ...]:
    """Return the names of all frames that any of the cameras has, in natural order."""
    return tuple(sorted({frame for own in files for frame in own}, key=natural_key))


def describe_frames(names: Iterable[str]) -> str:
    """Return the first and the last of the names in natural order, and their number."""
    ordered = sorted(names, key=natural_key)
    if len(ordered) < 3:
        return ", ".join(ordered)
    return f"{ordered[0]} … {ordered[-1]} ({len(ordered)})"


@dataclass(frozen=True, slots=True)
class _Numbering:
    """Frame names of one camera, which differ in one number only."""

    names: Mapping[int, str]
    """number → name."""
    before: str
    after: str
    """Text before and behind the number."""
    width: int
    """Digits of the longest number."""


def match_frames(
    files: Mapping[str, Mapping[str, Item]], place: str
) -> tuple[dict[str, Mapping[str, Item]], dict[str, str]]:
    """Return camera → frame → item under frame names common to all cameras, and lines on what was found.

    The lines are by camera; that of "" is on all of them.

    Names that agree stay. Where they differ (``cam0_003`` and ``cam1_003``, ``3`` and ``003``) and all names of each
    camera differ from each other in one number only, frames of the same number are one instant.

    Raises
    ------
    InputError
        When no two cameras have a frame in common, or the cameras' numbers begin at different values, so that it is
        unclear which frames belong together; the message lists the names of each camera in ``place``.
    """
    named = {camera: own for camera, own in files.items() if own}
    counts = Counter(frame for own in named.values() for frame in own)
    unlinked = [camera for camera, own in named.items() if all(counts[frame] == 1 for frame in own)]
    numberings = {camera: _parse(list(own), camera) for camera, own in named.items()}
    known = {camera: each for camera, each in numberings.items() if each is not None}
    if len(named) < 2 or _have_equal_names(known) or not (unlinked or len(known) == len(named)):
        lost = unlinked if len(named) > 1 else []
        if lost and len(lost) == len(named):
            raise InputError(f"{place}: no frame is of two cameras ({_describe(files)}); {_FIX}")
        return dict(files), {camera: _describe_unlinked(place, camera, files) for camera in lost}
    if len({min(each.names) for each in known.values()}) > 1 or len(known) < 2:
        raise InputError(
            f"{place}: the cameras name their frames differently, and it is unclear which are of one instant "
            f"({_describe(files)}); {_FIX}"
        )
    common = _name_numbers(list(known.values()))
    renamed = {
        camera: {common[number]: files[camera][name] for number, name in sorted(each.names.items())}
        for camera, each in known.items()
    }
    others = {camera: _describe_unlinked(place, camera, files) for camera in named if camera not in known}
    matched = _describe({camera: files[camera] for camera in known})
    return {**files, **renamed}, {"": f"{place}: frames are matched by their numbers ({matched})", **others}


def _parse(names: list[str], camera: str) -> _Numbering | None:
    """Return the numbering of a camera's frames; None unless their names differ in one number only.

    The only number of a single name is its frame's, beside those of the camera's name.
    """
    if len(names) == 1 and not camera.isdigit():
        split = [_DIGITS.split(names[0].replace(camera, "", 1))]
    else:
        split = [_DIGITS.split(name) for name in names]
    if len({tuple(parts[::2]) for parts in split}) > 1:
        return None
    numbers = range(1, len(split[0]), 2)
    varying = [place for place in numbers if len(names) == 1 or len({parts[place] for parts in split}) > 1]
    if len(varying) != 1:
        return None
    place = varying[0]
    by_number = {int(parts[place]): name for parts, name in zip(split, names, strict=True)}
    if len(by_number) < len(names):
        return None  # one number twice, such as 1 and 01
    before, after = "".join(split[0][:place]), "".join(split[0][place + 1 :])
    return _Numbering(by_number, before, after, max(len(parts[place]) for parts in split))


def _have_equal_names(numberings: Mapping[str, _Numbering]) -> bool:
    """Return whether every number has the same name in all cameras."""
    names: dict[int, set[str]] = {}
    for each in numberings.values():
        for number, name in each.names.items():
            names.setdefault(number, set()).add(name)
    return all(len(own) == 1 for own in names.values())


def _name_numbers(numberings: list[_Numbering]) -> dict[int, str]:
    """Return the common name of each number, with the text about it where that is one for all cameras."""
    width = max(each.width for each in numberings)
    texts = {(each.before, each.after) for each in numberings}
    before, after = texts.pop() if len(texts) == 1 else ("", "")
    numbers = {number for each in numberings for number in each.names}
    return {number: f"{before}{number:0{width}d}{after}" for number in numbers}


def _describe(files: Mapping[str, Iterable[str]]) -> str:
    return "; ".join(f"{camera} has {describe_frames(own)}" for camera, own in files.items())


def _describe_unlinked(place: str, camera: str, files: Mapping[str, Iterable[str]]) -> str:
    others = {name: own for name, own in files.items() if name != camera}
    return (
        f"{place}/{camera}: none of its frames ({describe_frames(files[camera])}) is named as one of another camera "
        f"({_describe(dict(list(others.items())[:1]))}); {_FIX}"
    )
