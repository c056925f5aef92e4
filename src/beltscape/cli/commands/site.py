"""``beltscape site site.toml``: one page for several belts, each measured by its own `beltscape run`."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("site", type=Path, help="site.toml: belts, transfer points, shifts, page")
    parser.add_argument(
        "--check", action="store_true", help="read every belt once, report the result, and stop"
    )


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Run until SIGINT or SIGTERM."""
    from beltscape.service.data_rights import restrict_rights
    from beltscape.service.hosting import log_to_stderr, make_stop_event
    from beltscape.site.run import check_site, run_site
    from beltscape.site.settings import read_site

    site = read_site(arguments.site)
    if arguments.check:
        return {"site": site.path, "checked": True, "parts": check_site(site, reporter.warn)}
    log_to_stderr()
    with restrict_rights(site.data):
        return run_site(site, make_stop_event())


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    if result.get("checked"):
        return "\n".join(f"{name:<12} {line}" for name, line in result["parts"].items())
    return f"sums of {len(result['belts'])} belts in {result['data']}"
