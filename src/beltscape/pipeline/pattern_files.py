"""The files of a speckle pattern: images, pattern.json and its quality."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Literal

from beltscape.files.atomic import write_bytes, write_text
from beltscape.files.images import write_image
from beltscape.files.json_text import write_json
from beltscape.report.blue_noise import draw_quality
from beltscape.target.blue_noise import BlueNoise, measure_blue_noise
from beltscape.target.pattern import Pattern
from beltscape.target.pattern_formats import draw_pattern, pattern_to_svg, write_pattern


def write_pattern_files(
    folder: Path, pattern: Pattern, *, bits: Literal[8, 16] = 8, image_format: Literal["png", "tiff"] = "png"
) -> tuple[dict[str, Path], BlueNoise]:
    """Write pattern.png or .tiff, .svg, .json, quality.json and .png; return their paths and the quality."""
    image, quality = draw_pattern(pattern, bits), measure_blue_noise(pattern)
    files = {
        "image": folder / f"pattern.{image_format}",
        "svg": folder / "pattern.svg",
        "pattern": folder / "pattern.json",
        "quality": folder / "quality.json",
        "picture": folder / "quality.png",
    }
    write_image(files["image"], image)
    write_text(files["svg"], pattern_to_svg(pattern))
    write_pattern(files["pattern"], pattern)
    write_json(files["quality"], asdict(quality))
    write_bytes(files["picture"], draw_quality(image, quality))
    return files, quality
