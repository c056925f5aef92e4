"""``beltscape rectify CAPTURE --rig rig.json --out DIR``: rectifies images into epipolar pairs."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from math import isnan
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_folder, require_positive_range
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("capture", type=Path, help="folder <capture>/<camera>/<frame>.png")
    parser.add_argument("--rig", type=Path, required=True, help="rig.json of beltscape calibrate")
    add_output_folder(parser, "folder for the rectified images", required=True)
    parser.add_argument(
        "--depth-range", nargs=2, type=float, metavar=("NEAR", "FAR"),
        help="depths the surface lies between, mm (default: found from the images)",
    )  # fmt: skip


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Rectify every frame; write images, geometry and the control picture."""
    from beltscape.files.rig_json import read_rig
    from beltscape.pipeline.reconstructing.rectification import rectify_capture

    rig = read_rig(arguments.rig)
    given = require_positive_range("--depth-range", arguments.depth_range)
    near_far, frames = rectify_capture(arguments.capture, rig, arguments.out, reporter, depth_range_mm=given)
    return {"depth_range_mm": near_far, "frames": frames}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    lines: list[str] = []
    for frame in result["frames"]:
        lines.append(f"{frame['folder'] / 'rectification.png'}")
        for pair in frame["pairs"]:
            rows = pair["row_error"]
            start = f"  {pair['core']} – {pair['auxiliary']}: baseline {pair['baseline_mm']:.2f} mm, "
            if isnan(rows["rms_px"]):
                lines.append(
                    f"{start}no correspondence found ({rows['points']} of {rows['searched']} points)"
                )
            else:
                lines.append(
                    f"{start}rows met within {rows['rms_px']:.3f} px (median offset {rows['median_px']:+.3f} ± "
                    f"{rows['sigma_px']:.3f} px, {rows['points']} of {rows['searched']} points)"
                )
    return "\n".join(lines)
