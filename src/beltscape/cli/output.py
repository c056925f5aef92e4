"""Handling of ``--out``: a command writes into a staging folder, and only success changes the user's folder."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

from beltscape.core.checks import is_dict, is_list_or_tuple, is_mapping
from beltscape.core.errors import BeltscapeError, OutputError

_OWN_JSON = ("rig.json", "belt.json")
"""Files whose ``format`` key names their kind."""
_HISTORIES = ("a", "b")
"""Arguments that name histories, which a comparison leaves as they are."""


@contextmanager
def manage_output(arguments: Namespace) -> Generator[Output]:
    """Yield the command's output and set ``arguments.out`` to its folder; commands without ``--out`` are unaffected.

    ``arguments.earlier`` is the user's folder, which may contain the command's earlier result. An error that names
    the staging folder is raised again with the user's folder.
    """
    out: Path | None = getattr(arguments, "out", None)
    kind = _resolve(getattr(arguments, "output", None), arguments)
    if out is None or kind is None:
        yield Output(Path(), Path())
        return
    _refuse_input(out, arguments)
    if kind == "file":
        refuse_file(out, _resolve(arguments.example, arguments))
        yield Output(out, out)
    else:
        with _folder(kind, out, _command(arguments)) as staging:
            output = Output(staging, out)
            arguments.out, arguments.earlier = staging, out
            try:
                yield output
            except BeltscapeError as error:
                raise type(error)(output.relocate(str(error))) from error


class Output:
    """The folder in which a command writes, and the final folder of its files."""

    def __init__(self, staging: Path, out: Path) -> None:
        self._staging, self._out = staging, out

    def relocate(self, value: Any) -> Any:
        """Return ``value`` with every path below the staging folder replaced by its final path."""
        if self._staging == self._out:
            return value
        if isinstance(value, Path):
            is_staged = value.is_relative_to(self._staging)
            return self._out / value.relative_to(self._staging) if is_staged else value
        if isinstance(value, str):
            return value.replace(
                f"{self._staging}/", "" if str(self._out) == "." else f"{self._out}/"
            ).replace(str(self._staging), str(self._out))
        if is_mapping(value):
            return {key: self.relocate(item) for key, item in value.items()}
        if is_list_or_tuple(value):
            return [self.relocate(item) for item in value]
        return value


def explain_failure(arguments: Namespace, name: str, data: bytes) -> Path:
    """Write a file that explains a failure into the user's folder, whose other files stay; return its path."""
    from beltscape.files.output_folder import add_file

    return add_file(arguments.earlier, _command(arguments), name, data)


def _resolve(default: Any, arguments: Namespace) -> Any:
    """Return a parser's default, or what it returns for these arguments if it is a function."""
    return cast("Callable[[Namespace], Any]", default)(arguments) if callable(default) else default


def refuse_file(out: Path, example: str) -> None:
    """Raise OutputError if the file ``--out`` is a folder, or exists and is of another kind than ``example``."""
    if out.is_dir():
        raise OutputError(f"--out {out}: is a folder; give a file, such as {out / example}")
    suffix = Path(example).suffix
    if example in _OWN_JSON and out.suffix != ".json":
        raise OutputError(f"--out {out}: must end in .json; give {out.with_suffix('.json')}")
    if out.is_file() and out.stat().st_size:
        if out.suffix.lower() != suffix:
            raise OutputError(
                f"--out {out}: exists and is no {suffix} file; choose another, such as {example}"
            )
        if example in _OWN_JSON:
            _refuse_other_json(out, example)


def _refuse_other_json(out: Path, example: str) -> None:
    """Raise OutputError if an existing JSON file is of another kind, such as a rig.json for a belt.json."""
    try:
        document = json.loads(out.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        document = None
    kind = f"beltscape-{Path(example).stem}/"
    if not is_dict(document) or not str(document.get("format", "")).startswith(kind):
        raise OutputError(f"--out {out}: exists and is no {example} of Beltscape; choose another name")


def _folder(kind: str, out: Path, command: str) -> Any:
    from beltscape.files.output_folder import continued_folder, owned_folder

    return (continued_folder if kind == "history" else owned_folder)(out, command)


def _command(arguments: Namespace) -> str:
    """Return the owner for the manifest: the command and the values that belong to it, such as a scene's name."""
    name, *keys = arguments.owner
    values = (getattr(arguments, key) for key in keys)
    return " ".join([name, *(Path(str(value)).stem for value in values if value is not None)])


def _refuse_input(out: Path, arguments: Namespace) -> None:
    """Raise OutputError if ``--out`` is an input, or lies in the input capture."""
    place = out.resolve()
    for name, value in vars(arguments).items():
        if name == "out" or not isinstance(value, Path) or not value.exists():
            continue
        read = value.resolve()
        if place == read:
            raise OutputError(f"--out {out}: is an input ({name} {value}); choose another --out")
        if name == "capture" and read in place.parents:
            raise OutputError(
                f"--out {out}: lies in the capture {value}, whose folders are cameras; choose an --out beside it"
            )
        if name in _HISTORIES and read in place.parents:
            raise OutputError(f"--out {out}: lies in the history {value}; choose an --out beside it")
