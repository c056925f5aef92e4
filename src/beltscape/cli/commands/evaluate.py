"""``beltscape evaluate paper|depth|lumps|belt``, each in a module ``evaluate_WHAT``."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from beltscape.cli.catalogue import Command
from beltscape.core.progress import Reporter

WHAT = {
    "paper": "the paper's experiments (Tables 2 and 3, Figs. 13-17) and other sensors, against the truth",
    "depth": "a reconstruction against the truth of its scene",
    "lumps": "lumps of a reconstructed frame against the rocks of its simulated heap",
    "belt": "the fused belt of a flow against the heights of its simulated heap",
}
"""Name → description of each evaluation."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the evaluations and their arguments."""
    commands = parser.add_subparsers(dest="what", required=True, metavar="WHAT")
    for name, text in WHAT.items():
        _module(name).add_arguments(commands.add_parser(name, help=text, description=text))


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Run the chosen evaluation."""
    return {**_module(arguments.what).run(arguments, reporter), "what": arguments.what}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    return _module(result["what"]).summary(result)


def _module(what: str) -> Command:
    return import_module(f"beltscape.cli.commands.evaluate_{what}")  # pyrefly: ignore[bad-return]
