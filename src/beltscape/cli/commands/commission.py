"""``beltscape commission [FOLDER]``: from bare cameras to a certificate in steps, on a page or in the terminal."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltscape.core.checks import is_dict, is_list_or_tuple
from beltscape.core.errors import SettingsError
from beltscape.core.progress import Reporter

if TYPE_CHECKING:
    from beltscape.commissioning.state import CommissionState

PORT = 8470
"""Port of the page, beside that of a plant, 8460."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "folder", type=Path, nargs="?", default=Path("commissioning"), metavar="FOLDER",
        help="folder of the plant; it is made, or gone on with where it was left (default: commissioning)",
    )  # fmt: skip
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="changes",
        help="answer what the page asks, such as source=trial, core=cam0, devices.cam0=192.168.10.11; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--step", metavar="NAME", help="run one step in the terminal, and stop; next: the first that is open"
    )
    parser.add_argument("--list", action="store_true", help="list the steps, how they stand, their commands")
    parser.add_argument("--port", type=int, default=PORT, help=f"TCP port of the page (default: {PORT})")
    parser.add_argument("--language", default="en", help="of the page: en, de, es or zh (default: en)")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Serve the page until SIGINT or SIGTERM; or run a step, list the steps, or change settings."""
    from beltscape.commissioning.state import CommissionState, parse_assignments

    state = CommissionState(arguments.folder)
    if arguments.changes:
        present = state.settings.model_dump(mode="json", exclude_unset=True)
        state.change_settings(parse_assignments(arguments.changes, present))
    if arguments.step:
        return _run_step(arguments, state, reporter)
    if arguments.list or arguments.changes:
        return _list(state)
    return _serve(arguments, state)


def _run_step(arguments: argparse.Namespace, state: CommissionState, reporter: Reporter) -> Mapping[str, Any]:
    from beltscape.commissioning.guided import take_views
    from beltscape.commissioning.runner import StepRun
    from beltscape.commissioning.steps import find_missing, find_next, find_step
    from beltscape.core.errors import InputError

    name = find_next(state) if arguments.step == "next" else find_step(arguments.step).name
    if name == "calibrate":
        if missing := find_missing(state, find_step(name)):
            raise InputError(f"step {name}: finish the step {missing} first")
        take_views(state, reporter)
    facts = StepRun(state, reporter).run(name)
    return {"step": name, "result": facts, **_list(state)}


def _list(state: CommissionState) -> Mapping[str, Any]:
    from beltscape.commissioning.steps import STEPS, get_status, list_commands

    return {
        "folder": state.folder,
        "steps": [
            {
                "name": step.name,
                "status": get_status(state, step),
                "commands": [" ".join(("beltscape", *words)) for words in list_commands(state, step.name)],
            }
            for step in STEPS
        ],
    }


def _serve(arguments: argparse.Namespace, state: CommissionState) -> Mapping[str, Any]:
    from beltscape.commissioning.serving import serve_commission
    from beltscape.service.hosting import log_to_stderr, make_stop_event
    from beltscape.service.settings import require_language

    if not 0 <= arguments.port <= 65_535:
        raise SettingsError(f"--port {arguments.port}: must be 0 to 65535")
    try:
        require_language(arguments.language)
    except ValueError as error:
        raise SettingsError(f"--language: {error}") from error
    log_to_stderr()
    serve_commission(state, arguments.port, arguments.language, make_stop_event())
    return _list(state)


def summary(result: Mapping[str, Any]) -> str:
    """Return the steps, a line each, and what the step that was run found."""
    marks = {"done": "ok", "open": "--", "blocked": "..", "outdated": "!!"}
    lines = [
        f"{marks[one['status']]} {one['name']:<12} {'; '.join(one['commands'])}".rstrip()
        for one in result["steps"]
    ]
    if "result" in result:
        found = ", ".join(f"{key} {_format(value)}" for key, value in result["result"].items())
        lines.append(f"{result['step']}: {found}")
    return "\n".join(lines)


def _format(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if is_list_or_tuple(value):
        return ", ".join(_format(item) for item in value) or "none"
    if is_dict(value):
        return ", ".join(f"{key} {_format(item)}" for key, item in value.items())
    return str(value)
