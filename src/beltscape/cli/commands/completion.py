"""``beltscape completion SHELL``: prints what makes a shell complete commands, options and files."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from beltscape.core.progress import Reporter

SHELLS = ("bash", "zsh", "fish")
ASKED = "_ARGCOMPLETE"
"""Environment variable that argcomplete sets when a shell asks for completions."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("shell", choices=SHELLS, help="the shell that shall complete")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Return the shell's code."""
    from argcomplete.shell_integration import shellcode

    return {"shell": arguments.shell, "code": shellcode(["beltscape"], shell=arguments.shell)}


def summary(result: Mapping[str, Any]) -> str:
    """Return the code, to be evaluated by the shell."""
    return str(result["code"]).rstrip("\n")


def answer(parser: argparse.ArgumentParser) -> None:
    """Print the completions of the command line that the shell passes by its environment, and end the program."""
    import argcomplete

    argcomplete.autocomplete(parser, always_complete_options="long")
