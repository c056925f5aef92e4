"""The interface of a command's module: arguments, run, and the summary of its result."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any, Protocol

from beltscape.core.progress import Reporter


class Command(Protocol):
    """The interface of a command's module."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the command's arguments."""

    def run(self, arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
        """Run the command; return what ``--json`` prints."""
        ...

    def summary(self, result: Mapping[str, Any]) -> str:
        """Return the result in a few readable lines."""
        ...
