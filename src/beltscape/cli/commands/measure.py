"""``beltscape measure QUANTITY``, each in a module ``measure_QUANTITY``."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from beltscape.cli.catalogue import Command
from beltscape.core.progress import Reporter

QUANTITIES = {
    "belt": "the empty belt's shape, place and ends, learned from any number of frames",
    "zero": "the empty belt's motion since it was learned; sets the zero within a limit",
    "features": "dimensions of a calibration module: edges, heights, radii, each with its σ",
    "volume": "between loaded and empty belt, with cross-section profiles",
    "flow": "what passes on a moving belt: one row per frame, totals",
    "lumps": "of the top layer: sizes, distribution, oversize alarm",
}
"""Name → description of each quantity."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the quantities and their arguments."""
    quantities = parser.add_subparsers(dest="quantity", required=True, metavar="QUANTITY")
    for name, what in QUANTITIES.items():
        module = _module(name)
        module.add_arguments(quantities.add_parser(name, help=what, description=what))


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Measure the chosen quantity."""
    return {**_module(arguments.quantity).run(arguments, reporter), "quantity": arguments.quantity}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    return _module(result["quantity"]).summary(result)


def _module(quantity: str) -> Command:
    return import_module(f"beltscape.cli.commands.measure_{quantity}")  # pyrefly: ignore[bad-return]
