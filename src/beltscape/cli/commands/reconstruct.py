"""``beltscape reconstruct CAPTURE --rig rig.json --out DIR [--method …]``: frame sets to depth maps and clouds."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from importlib import import_module
from math import isnan
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import (
    CLOUD_FORMATS,
    add_output_folder,
    add_preset,
    add_workers,
    require_positive_range,
)
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("capture", type=Path, help="folder <capture>/<camera>/<frame>.png")
    parser.add_argument("--rig", type=Path, required=True, help="rig.json of beltscape calibrate")
    add_output_folder(parser, "folder for one folder per frame", required=True)
    parser.add_argument(
        "--method", default="multiview",
        help="multiview (default: all auxiliaries at once), or the paper's pairwise or binocular",
    )  # fmt: skip
    add_preset(parser, "multiview")
    parser.add_argument(
        "--pair", metavar="CAMERA", help="binocular: the auxiliary (default: beside the core)"
    )
    parser.add_argument(
        "--depth-range", nargs=2, type=float, metavar=("NEAR", "FAR"),
        help="search between these depths, mm (default: found from the images)",
    )  # fmt: skip
    parser.add_argument(
        "--cloud", choices=CLOUD_FORMATS, action="append", default=[],
        help="also write each cloud as LAS or LAZ, in m; can be given twice (pip install beltscape[export])",
    )  # fmt: skip
    add_workers(parser)


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Reconstruct every frame and write its folder."""
    from beltscape.files.rig_json import read_rig
    from beltscape.pipeline.reconstructing.reconstruction import reconstruct_capture
    from beltscape.workers.options import WorkerOptions

    workers = WorkerOptions(arguments.workers, arguments.address)
    if arguments.cloud:
        import_module("laspy")  # a missing package is reported before anything is computed

    result = reconstruct_capture(
        arguments.capture,
        read_rig(arguments.rig),
        arguments.out,
        reporter,
        method=arguments.method,
        pair=arguments.pair,
        preset=arguments.preset,
        depth_range_mm=require_positive_range("--depth-range", arguments.depth_range),
        clouds=arguments.cloud,
        workers=workers,
    )
    return {
        "method": arguments.method,
        "auxiliaries": result.auxiliaries,
        "depth_range_mm": result.depth_range_mm,
        "regions": result.regions,
        "frames": result.frames,
    }


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    near, far = result["depth_range_mm"]
    lines = [
        f"{result['method']} with {', '.join(result['auxiliaries'])}, searched {near:.0f} to {far:.0f} mm"
    ]
    lines += [
        f"{f['folder']}  {f['coverage']:.1%} measured, median depth {f['median_depth_mm']:.2f} mm, "
        f"σ {f['median_sigma_mm']:.3f} mm"
        for f in result["frames"]
    ]
    lines += _cameras(result["frames"][0]["consistency"])
    return "\n".join(lines)


def _cameras(consistency: Mapping[str, Any] | None) -> list[str]:
    """Return one line per camera with its consistency with the rig in the first frame."""
    if consistency is None:
        return []
    return [f"  {each['camera']}  {each['state']}{_agreement(each)}" for each in consistency["cameras"]]


def _agreement(camera: Mapping[str, Any]) -> str:
    if isnan(camera["epipolar_px"]):
        return f": {camera['points']} of {camera['searched']} points found"
    return (
        f": {camera['epipolar_px']:.2f} ± {camera['epipolar_sigma_px']:.2f} px off its epipolar lines, "
        f"{camera['agreement']:.0%} of {camera['searched']} points agree"
    )
