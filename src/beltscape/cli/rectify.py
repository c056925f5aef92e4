"""``beltscape rectify CAPTURE --rig rig.json --out DIR``."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import positive_range
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("capture", type=Path, help="folder <capture>/<camera>/<frame>.png")
    parser.add_argument("--rig", type=Path, required=True, help="rig.json of beltscape calibrate")
    parser.add_argument("--out", type=Path, required=True, help="folder for the rectified images")
    parser.add_argument(
        "--depth-range", nargs=2, type=float, metavar=("NEAR", "FAR"),
        help="depths the surface lies between, mm (default: found from the images)",
    )  # fmt: skip


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Rectify every frame; write images, geometry and the check picture."""
    from beltscape.files.atomic import output_folder
    from beltscape.files.images import write_image
    from beltscape.files.json_text import write_json
    from beltscape.files.rig_json import read_rig
    from beltscape.pipeline.reconstruction import depth_range, open_capture
    from beltscape.pipeline.rectification import rectify
    from beltscape.report.rectification import check_picture
    from beltscape.stereo.settings import PairwiseSettings

    rig = read_rig(arguments.rig)
    given = positive_range("--depth-range", arguments.depth_range)
    source = open_capture(arguments.capture, rig, reporter)
    out = output_folder(arguments.out)
    near_far = given or depth_range(source, rig, PairwiseSettings(), reporter)
    frames = []
    for frame_set, pairs in rectify(source, rig, near_far, reporter):
        folder = out / frame_set.frame
        for images in pairs:
            write_image(folder / images.pair.auxiliary / "core.png", images.core)
            write_image(folder / images.pair.auxiliary / "auxiliary.png", images.auxiliary)
        write_image(folder / "rectification.png", check_picture(rig, frame_set, pairs))
        document = {"frame": frame_set.frame, "pairs": [_document(images) for images in pairs]}
        write_json(folder / "rectification.json", document)
        frames.append({**document, "folder": folder})
    return {"depth_range_mm": near_far, "frames": frames}


def _document(images: Any) -> Mapping[str, Any]:
    pair, rows = images.pair, images.rows
    return {
        "core": pair.core,
        "auxiliary": pair.auxiliary,
        "size_px": pair.size_px,
        "focal_px": pair.focal_px,
        "core_center_px": pair.core_center_px,
        "auxiliary_center_px": pair.aux_center_px,
        "baseline_mm": pair.baseline_mm,
        "disparities": pair.disparities,
        "rectified_from_core": pair.rectified_from_core.rotation,
        "rectified_from_auxiliary": pair.rectified_from_aux.rotation,
        "row_error": {"points": rows.points, "median_px": rows.median_px, "rms_px": rows.rms_px},
    }


def summary(result: Mapping[str, Any]) -> str:
    """The result in a few lines."""
    lines = []
    for frame in result["frames"]:
        lines.append(f"{frame['folder'] / 'rectification.png'}")
        for pair in frame["pairs"]:
            rows = pair["row_error"]
            lines.append(
                f"  {pair['core']} – {pair['auxiliary']}: baseline {pair['baseline_mm']:.2f} mm, rows met within "
                f"{rows['rms_px']:.3f} px (median offset {rows['median_px']:+.3f} px, {rows['points']} points)"
            )
    return "\n".join(lines)
