"""``beltscape demo [--out DIR]``: runs the whole chain on the shipped capture and compares it with the truth."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_folder
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_output_folder(parser, "folder (default: beltscape-demo)", default=Path("beltscape-demo"))


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Run the whole chain and write report.html."""
    from beltscape.evaluate.demo import make_demo_document, render_demo_page, run_demo
    from beltscape.files.atomic import ensure_output_folder, write_text

    out = ensure_output_folder(arguments.out)
    demo = run_demo(out, reporter)
    write_text(out / "report.html", render_demo_page(demo))
    return make_demo_document(demo)


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    lines: list[str] = []
    for scene, methods in result["depth_against_truth"].items():
        for method, s in methods.items():
            lines.append(
                f"{scene:<12} {method:<10} {s['within_1mm']:6.1%} within 1 mm, median error "
                f"{s['interior_median_mm']:.3f} mm, {s['coverage']:.1%} measured"
            )
    for scene, v in result["volume_against_truth"].items():
        lines.append(
            f"{scene:<12} {v['volume_mm3'] * 1e-6:.3f} ± {v['sigma_mm3'] * 1e-6:.3f} l, true "
            f"{v['true_mm3'] * 1e-6:.3f} l ({v['volume_mm3'] / v['true_mm3'] - 1:+.2%})"
        )
    return "\n".join([*lines, f"report       {result['report']}"])
