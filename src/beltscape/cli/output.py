"""The one door to ``--out``: a command writes into a staging folder, and only success changes the user's folder."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from beltscape.core.errors import BeltscapeError, OutputError

_OWN_JSON = ("rig.json", "belt.json")
"""Files that say in their ``format`` what they are."""


@contextmanager
def output_of(arguments: Namespace) -> Iterator[Output]:
    """Yield where the command writes, and set ``arguments.out`` to it; commands without ``--out`` pass through.

    ``arguments.earlier`` is the folder that the user gave, where the command's earlier result may lie.
    An error that names the staging folder is raised anew with the folder that the user gave.
    """
    out: Path | None = getattr(arguments, "out", None)
    kind = getattr(arguments, "output", None)
    if callable(kind):
        kind = kind(arguments)
    if out is None or kind is None:
        yield Output(Path(), Path())
        return
    _refuse_input(out, arguments)
    if kind == "file":
        example = arguments.example
        refuse_file(out, example(arguments) if callable(example) else example)
        yield Output(out, out)
    else:
        with _folder(kind, out, _command(arguments)) as place:
            output = Output(place, out)
            arguments.out, arguments.earlier = place, out
            try:
                yield output
            except BeltscapeError as error:
                raise type(error)(output.moved(str(error))) from error


class Output:
    """Where a command writes, and where that will lie once it has succeeded."""

    def __init__(self, staging: Path, out: Path) -> None:
        self._staging, self._out = staging, out

    def moved(self, value: Any) -> Any:
        """Return ``value`` with every path below the staging folder replaced by its final place."""
        if self._staging == self._out:
            return value
        if isinstance(value, Path):
            below = value.is_relative_to(self._staging)
            return self._out / value.relative_to(self._staging) if below else value
        if isinstance(value, str):
            return value.replace(
                f"{self._staging}/", "" if str(self._out) == "." else f"{self._out}/"
            ).replace(str(self._staging), str(self._out))
        if isinstance(value, Mapping):
            return {key: self.moved(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [self.moved(item) for item in value]
        return value


def refuse_file(out: Path, example: str) -> None:
    """Raise OutputError where the file ``--out`` is a folder, or a file of another kind than ``example``."""
    if out.is_dir():
        raise OutputError(f"--out {out}: is a folder; give a file, such as {out / example}")
    suffix = Path(example).suffix
    if example in _OWN_JSON and out.suffix != ".json":
        raise OutputError(f"--out {out}: must end in .json; give {out.with_suffix('.json')}")
    if out.is_file() and out.stat().st_size:
        if out.suffix.lower() != suffix:
            raise OutputError(
                f"--out {out}: is there and is no {suffix} file; choose another, such as {example}"
            )
        if example in _OWN_JSON:
            _refuse_other_json(out, example)


def _refuse_other_json(out: Path, example: str) -> None:
    """A rig.json is not replaced by a belt.json."""
    try:
        found = json.loads(out.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        found = None
    kind = f"beltscape-{Path(example).stem}/"
    if not isinstance(found, dict) or not str(found.get("format", "")).startswith(kind):
        raise OutputError(f"--out {out}: is there and is no {example} of Beltscape; choose another name")


def _folder(kind: str, out: Path, command: str) -> Any:
    from beltscape.files.folders.owned_folder import continued_folder, owned_folder

    return (continued_folder if kind == "history" else owned_folder)(out, command)


def _command(arguments: Namespace) -> str:
    """The owner as the manifest names it: the command, and what belongs to it, such as a scene's name."""
    name, *keys = arguments.owner
    values = (getattr(arguments, key) for key in keys)
    return " ".join([name, *(Path(str(value)).stem for value in values if value is not None)])


def _refuse_input(out: Path, arguments: Namespace) -> None:
    """Raise OutputError where ``--out`` is what is read, or lies in the capture that is read."""
    place = out.resolve()
    for name, value in vars(arguments).items():
        if name == "out" or not isinstance(value, Path) or not value.exists():
            continue
        read = value.resolve()
        if place == read:
            raise OutputError(f"--out {out}: is what is read ({name} {value}); choose another --out")
        if name == "capture" and read in place.parents:
            raise OutputError(
                f"--out {out}: lies in the capture {value}, whose folders are cameras; choose an --out beside it"
            )
