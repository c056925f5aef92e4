"""``beltscape view DIR [--out scene.html] [--rerun]``: opens rigs, frames and sequences in a 3-D viewer."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_file
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "source", type=Path, help="rig.json or its folder, a frame's folder, a reconstruction"
    )
    parser.add_argument("--belt", type=Path, help="belt.json: shows the belt, and stands everything upright")
    parser.add_argument("--features", type=Path, help="features.json of measure features: fitted primitives")
    parser.add_argument(
        "--rerun", action="store_true", help="in the Rerun viewer (pip install beltscape[viewer])"
    )
    add_output_file(parser, "write the page (with --rerun: the .rrd) instead of opening it", "scene.html")
    parser.set_defaults(example=_example)


def _example(arguments: argparse.Namespace) -> str:
    return "scene.rrd" if arguments.rerun else "scene.html"


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Write the viewer's page and open it, or log the view to Rerun."""
    from beltscape.pipeline.view import collect_view, write_view

    if arguments.rerun:
        from beltscape.pipeline.view_rerun import import_rerun, show_in_rerun

        rerun = import_rerun()  # imported first, so that a missing package is reported at once
        view = collect_view(arguments.source, belt=arguments.belt, features=arguments.features)
        show_in_rerun(rerun, view, arguments.out)
        reporter.step("viewing", 1, 1)
        return {"view": arguments.out, "opened": arguments.out is None, "frames": len(view.clouds)}
    view = collect_view(arguments.source, belt=arguments.belt, features=arguments.features)
    out, opened = arguments.out, False
    if out is None:
        out, opened = _temporary(), True
    write_view(out, view)
    reporter.step("viewing", 1, 1)
    if opened:
        import webbrowser

        opened = webbrowser.open(out.resolve().as_uri())
    return {"view": out, "opened": opened, "frames": len(view.clouds)}


def _temporary() -> Path:
    from tempfile import mkdtemp

    return Path(mkdtemp(prefix="beltscape-view-")) / "scene.html"


def summary(result: Mapping[str, Any]) -> str:
    """Return the location of the view."""
    if result["view"] is None:
        return "shown in Rerun"
    return f"view {result['view']}" + ("" if not result["opened"] else ", opened in the browser")
