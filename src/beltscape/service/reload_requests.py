"""Requests of `beltscape reload` to a running plant: files in its data folder, which only its own user may write.

The command creates ``reload-<token>.request``; the run removes it, reads the settings again and writes its answer as
``reload-<token>.json``, which the command reads and removes.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from beltscape.core.checks import is_dict
from beltscape.core.errors import BeltscapeError, InputError, OutputError
from beltscape.files.atomic import output_error
from beltscape.files.json_text import read_json, write_json
from beltscape.pipeline.live.check import is_running
from beltscape.service.reloader import Reload, SettingsReloader

_REQUEST, _ANSWER = ".request", ".json"
_PREFIX = "reload-"
_POLL_S = 0.1
"""Interval at which the command looks for the answer."""
_PATIENCE_S = 120.0
"""Longest wait for an answer: a rig of many cameras on a busy machine takes some seconds."""


def discard_requests(data: Path) -> None:
    """Remove what an earlier run left unanswered, and answers that nobody read."""
    for path in data.glob(f"{_PREFIX}*"):
        if path.suffix in (_REQUEST, _ANSWER):
            with suppress(OSError):
                path.unlink()


def answer_requests(data: Path, reloader: SettingsReloader) -> None:
    """Answer the requests in the data folder; a disk that takes no answer leaves the command without one."""
    for path in sorted(data.glob(f"{_PREFIX}*{_REQUEST}")):
        by = _find_owner(path)
        with suppress(OSError):
            path.unlink()
        try:
            answer = describe_reload(reloader.reload(f"{by} on this machine", "beltscape reload"))
        except BeltscapeError as error:
            answer = {"refused": str(error)}
        with suppress(BeltscapeError):
            write_json(path.with_suffix(_ANSWER), answer)


def describe_reload(done: Reload) -> dict[str, Any]:
    """Return a reload as the command and the page print it."""
    names = ("at_once", "restart")
    return {
        name: [{"key": one.key, "before": one.before, "after": one.after} for one in getattr(done, name)]
        for name in names
    }


def request_reload(
    data: Path, patience_s: float = _PATIENCE_S, wait: Callable[[float], None] = sleep
) -> Mapping[str, Any]:
    """Ask the run of a data folder to read its settings again; return its answer.

    Raises
    ------
    InputError
        If nothing runs, the run does not answer, or it refuses the settings.
    OutputError
        If the folder cannot be written.
    """
    fix = "beltscape reload changes a running plant; the settings are read at the next beltscape run"
    if not is_running(data):
        raise InputError(f"{data}: nothing runs with this data folder; {fix}")
    request = data / f"{_PREFIX}{secrets.token_hex(8)}{_REQUEST}"
    answer, end = request.with_suffix(_ANSWER), monotonic() + patience_s
    try:
        request.touch()
    except OSError as error:
        raise output_error(request, error) from error
    try:
        while not answer.is_file():
            if monotonic() > end or not is_running(data):
                raise OutputError(
                    f"{data}: the run did not answer; its log says why, its settings may be the old"
                )
            wait(_POLL_S)
        found = read_json(answer)
    finally:
        for path in (request, answer):
            path.unlink(missing_ok=True)
    if not is_dict(found):
        raise InputError(f"{answer}: is no answer of a run")
    if "refused" in found:
        raise InputError(f"{found['refused']}; the running settings stay as they were")
    return found


def _find_owner(path: Path) -> str:
    try:
        return path.owner()
    except (OSError, KeyError, NotImplementedError):
        return "somebody"
