"""The program ``beltscape``: selects the command, runs it, and turns errors into one line and an exit code."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import NoReturn, cast

from beltscape import __version__
from beltscape.cli.command import Command
from beltscape.cli.commands import completion
from beltscape.cli.examples import add_examples
from beltscape.cli.failure import UsageError, report_failure

COMMANDS = {
    "plan": "belt, camera and lens → heights, poses, coverage, depth σ, light, frame rate",
    "target": "speckle pattern for the projector, calibration board to print in true size",
    "simulate": "a rendered capture of a scene, with its exact truth",
    "demo": "the whole chain on a small rig that ships with Beltscape, ending in a report",
    "calibrate": "images of a board → rig.json, calibration.json, report.html",
    "check": "score a rig on board views it has never seen, in px and in mm",
    "rectify": "epipolar rectification about the core camera, with the check picture",
    "reconstruct": "images → depth, its uncertainty and a point cloud, frame by frame",
    "measure": "belt, volume, flow, lumps, a module's dimensions",
    "evaluate": "the paper's experiments side by side, a depth map against its truth",
    "run": "live: cameras → records → history, alarms and the operator's page",
    "site": "several belts, each measured by its own run: one page, balances over transfer points, totals",
    "reload": "a running plant reads its settings, rig and empty belt again, without a stop",
    "replay": "a recorded capture through the running system, at full or at its own speed",
    "reprocess": "recordings measured again, a year of them on a cluster, into one ledger",
    "compare": "two measurements of the same belt: flow, totals, where and why they differ, with σ",
    "backup": "history, users, settings, rig, belt and certificates of a plant, while it runs",
    "restore": "a backup back in its place, on this machine or an empty one",
    "cameras": "cameras on the network, and whether a project's settings fit them",
    "record": "images from a project's cameras: views of the board by key or timer, sequences of the belt",
    "users": "who may open the operator's page: list, add, remove, passwords, roles",
    "view": "a rig, a frame or a sequence in 3-D, with belt and fitted primitives, in the browser",
    "export": "rig.json → OpenCV YAML, Kalibr camchain, COLMAP rig, ROS camera_info; a cloud → LAS, LAZ, PLY",
    "import": "one of these → rig.json",
    "doctor": "what is installed, and whether this machine suits the job",
    "completion": "completion of commands and options for bash, zsh and fish",
}
"""Command → its description. The module of its name in `commands` is imported only when the command is called."""


class OneLineParser(argparse.ArgumentParser):
    """Parser whose usage errors are one line with the fix."""

    def error(self, message: str) -> NoReturn:
        """Raise UsageError with the message in one line."""
        raise UsageError(f"{self.prog}: {message}; see: {self.prog} --help")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; return the exit code: 0 on success, else that of `beltscape.cli.failure`."""
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        return _run_command(words)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (Exception, KeyboardInterrupt) as error:
        return report_failure(error, as_json="--json" in words)


def _run_command(words: Sequence[str]) -> int:
    if completion.ASKED in os.environ:
        _complete()
    name = words[0] if words else ""
    if name not in COMMANDS:
        return _run_top_level(words)
    parser = OneLineParser(prog=f"beltscape {name}", description=COMMANDS[name])
    command = _declare(name, parser)
    add_examples(parser, name)
    return _run(command, parser.parse_args(words[1:]))


def _complete() -> None:
    """Answer a shell's question for completions with the arguments of all commands."""
    parser = OneLineParser(prog="beltscape")
    parsers = parser.add_subparsers()
    for name, description in COMMANDS.items():
        _declare(name, parsers.add_parser(name, help=description))
    completion.answer(parser)


def _declare(name: str, parser: argparse.ArgumentParser) -> Command:
    """Declare the arguments of a command; return its module."""
    command: Command = import_module(f"beltscape.cli.commands.{name}")  # pyright: ignore[reportAssignmentType]
    command.add_arguments(parser)
    _add_json(parser)
    return command


def _run(command: Command, arguments: argparse.Namespace) -> int:
    from beltscape.cli.output import manage_output
    from beltscape.cli.terminal import Terminal
    from beltscape.files.documents.json_text import to_json

    with Terminal() as terminal, manage_output(arguments) as output:
        result = {**output.relocate(command.run(arguments, terminal)), "warnings": terminal.warnings}
    text = to_json(result) if arguments.json else command.summary(result) + "\n"
    sys.stdout.write(text)
    sys.stdout.flush()
    return 0


def _add_json(parser: argparse.ArgumentParser) -> None:
    for action in parser._actions:
        # argparse has no public way to list sub-commands
        if isinstance(action, argparse._SubParsersAction):  # pyright: ignore[reportPrivateUsage]
            for child in cast("dict[str, argparse.ArgumentParser]", action.choices).values():
                _add_json(child)
            return
    parser.add_argument("--json", action="store_true", help="print the result as one JSON document")


def _run_top_level(words: Sequence[str]) -> int:
    lines = "\n".join(f"  {name:<12} {description}" for name, description in COMMANDS.items())
    parser = OneLineParser(
        prog="beltscape",
        usage="beltscape COMMAND [...]",
        description="Cameras over a conveyor belt become a 3-D sensor for bulk material.",
        epilog=f"commands:\n{lines}\n\nbeltscape COMMAND --help shows a command's arguments.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"beltscape {__version__}")
    parser.add_argument("command", nargs="?", help=argparse.SUPPRESS)
    arguments, unknown = parser.parse_known_args(words)
    if arguments.command is not None:
        from difflib import get_close_matches

        command: str = arguments.command
        near = get_close_matches(command, COMMANDS, n=1)
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(COMMANDS)}"
        parser.error(f"no command {arguments.command!r}; {hint}")
    if unknown:
        parser.error(f"no option {unknown[0]}")
    parser.print_help()
    return 0
