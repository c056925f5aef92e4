"""``beltscape simulate SCENE --out DIR``: renders a capture with its truth."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_folder
from beltscape.core.progress import Reporter

SCENES = ("calibration", "module", "belt_empty", "belt_loaded", "belt_moving")
SIZES = {"full": 1.0, "half": 0.5, "quarter": 0.25}
"""Share of the sensor's pixels in each direction, by name."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("scene", metavar="SCENE", help=f"{', '.join(SCENES)}, or a scene's TOML file")
    add_output_folder(parser, "folder for the capture, its truth in truth/", required=True, owner=("scene",))
    parser.add_argument("--frames", type=int, help="how many (as the scene needs)")
    parser.add_argument(
        "--seed", type=int, help="of noise, heap and poses of the board, not of the plant (1)"
    )
    parser.add_argument(
        "--size", choices=SIZES, help="of the images: the sensor's, or 2 × 2, 4 × 4 put together"
    )
    parser.add_argument(
        "--rig", type=Path, metavar="RIG", help="rig.json of the true rig (the paper's laboratory)"
    )
    parser.add_argument("--height", type=float, metavar="MM", help="of its core camera over the belt (744)")
    parser.add_argument("--no-speckle", action="store_true", help="projector off")
    parser.add_argument("--tof", action="store_true", help="a time-of-flight camera as well, in tof/")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Render the capture."""
    from beltscape.pipeline.simulation import read_scenario, simulate

    return simulate(read_scenario(arguments.scene, _read_overrides(arguments)), arguments.out, reporter)


def _read_overrides(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options given on the command line, in the scene file's form."""
    rig = {
        "scale": SIZES[arguments.size] if arguments.size else None,
        "file": str(arguments.rig) if arguments.rig else None,
        "height_mm": arguments.height,
    }
    overrides: dict[str, Any] = {"frames": arguments.frames, "seed": arguments.seed}
    overrides["rig"] = {key: value for key, value in rig.items() if value is not None}
    overrides["speckle"] = False if arguments.no_speckle else None
    overrides["tof"] = {} if arguments.tof else None
    return {
        key: value
        for key, value in overrides.items()
        if value not in (None, {}) or (key == "tof" and value == {})
    }


def summary(result: Mapping[str, Any]) -> str:
    """Format the result in a few lines."""
    return "\n".join(
        [
            f"{result['scene']}: {result['frames']} frames of {len(result['cameras'])} cameras",
            f"capture {result['capture']}",
            f"truth   {result['truth']}",
            f"picture {result['preview']}",
        ]
    )
