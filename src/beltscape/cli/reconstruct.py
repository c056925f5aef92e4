"""``beltscape reconstruct CAPTURE --rig rig.json --out DIR [--method pairwise|binocular]``."""

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
    parser.add_argument("--out", type=Path, required=True, help="folder for one folder per frame")
    parser.add_argument("--method", default="pairwise", help="pairwise (default), binocular or multiview")
    parser.add_argument("--pair", metavar="CAMERA", help="binocular: the auxiliary (default: beside the core)")
    parser.add_argument(
        "--depth-range", nargs=2, type=float, metavar=("NEAR", "FAR"),
        help="search between these depths, mm (default: found from the images)",
    )  # fmt: skip


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Reconstruct every frame and write its folder."""
    from beltscape.files.atomic import output_folder
    from beltscape.files.reconstruction import write_frame
    from beltscape.files.rig_json import read_rig, write_rig
    from beltscape.pipeline.reconstruction import auxiliaries_for, depth_range, open_capture, reconstruct
    from beltscape.report.pictures import preview
    from beltscape.stereo.cloud import cloud_from_depth, undistorted
    from beltscape.stereo.settings import PairwiseSettings

    rig, settings = read_rig(arguments.rig), PairwiseSettings()
    auxiliaries = auxiliaries_for(arguments.method, rig, arguments.pair)
    given = positive_range("--depth-range", arguments.depth_range)
    source = open_capture(arguments.capture, rig, reporter)
    out = output_folder(arguments.out)
    near_far = given or depth_range(source, rig, settings, reporter)
    write_rig(out / "rig.json", rig)
    frames = []
    for frame in reconstruct(source, rig, auxiliaries, near_far, settings, reporter):
        name, camera, image = frame.frame_set.frame, rig.core_camera, frame.frame_set.images[rig.core]
        cloud = cloud_from_depth(frame.depth, camera, image)
        write_frame(out / name, frame.depth, cloud, preview(frame.depth, undistorted(image, camera)))
        frames.append(_document(out / name, frame))
        reporter.step("reconstructing", len(frames), len(source))
    return {"method": arguments.method, "auxiliaries": auxiliaries, "depth_range_mm": near_far, "frames": frames}


def _document(folder: Path, frame: Any) -> Mapping[str, Any]:
    import numpy as np

    depth = frame.depth
    return {
        "frame": frame.frame_set.frame,
        "folder": folder,
        "coverage": depth.coverage,
        "median_depth_mm": float(np.nanmedian(depth.depth_mm)) if depth.measured.any() else float("nan"),
        "median_sigma_mm": float(np.nanmedian(depth.sigma_mm)) if depth.measured.any() else float("nan"),
    }


def summary(result: Mapping[str, Any]) -> str:
    """The result in a few lines."""
    near, far = result["depth_range_mm"]
    lines = [f"{result['method']} with {', '.join(result['auxiliaries'])}, searched {near:.0f} to {far:.0f} mm"]
    lines += [
        f"{f['folder']}  {f['coverage']:.1%} measured, median depth {f['median_depth_mm']:.2f} mm, "
        f"σ {f['median_sigma_mm']:.3f} mm"
        for f in result["frames"]
    ]
    return "\n".join(lines)
