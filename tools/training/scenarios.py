"""The training scenarios: plants, materials and sensors drawn at random, each from its own seed.

Scenario i is drawn from the seed ``[i, 27]``: rig and projector, belt, heap or module, sensor. Numbers below
`HELD_OUT` are for training; those from there on are rendered to assess the networks and are never trained on. They
are of other kinds as well: a pattern, a material and a placement of the cameras that no training scenario has, and
cores that are tilted further.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.progress import Silent
from beltscape.pipeline.simulation import simulate
from beltscape.simulate.scenario import Scenario
from training.materials import draw_heap

HELD_OUT = 1000
"""Number of the first scenario that is not trained on."""
_FAMILY = 27
"""Second part of every seed: another value gives other scenarios."""
_KINDS = (
    "belt_loaded",
    "belt_loaded",
    "module",
    "belt_loaded",
    "belt_loaded",
    "module",
    "belt_loaded",
    "belt_empty",
)
"""Kinds in turn, so that any few consecutive scenarios hold all of them."""
_WIDTHS_PX = ((0, (480, 612, 612, 816)), (40, (816, 1024, 1224)), (HELD_OUT, (612, 816, 1224)))
"""First scenario, and the widths of the images from there on: the first scenarios are small, hence cheap."""
_CLOSE = 40
"""First scenario that sees only half of the belt's width: its pixels are as large on the belt as a full sensor's,
for a quarter of the cost."""
_SHAPES = (5 / 6, 3 / 4, 5 / 8)
"""Heights of the images over their widths: of the paper's sensor, and of two others."""
SENSOR_MM = 8.4456
"""Width of the paper's sensor; the focal length follows from it and from the view."""
_WITHOUT_PATTERN = 11
"""Period of the scenarios whose projector is off: most surfaces that are found there are false."""
_AUXILIARIES = (1, 2, 2, 3, 3, 4, 4, 5, 6)
"""Numbers of auxiliaries, all as frequent."""
_PART_DEG, _MOST_IN_PART, _HELD_OUT_PART_DEG = 180.0, 3, 120.0
"""Angle within which a few auxiliaries stand on one side of the core, two of them in an L; their largest number; and
the angle of scenarios that are held out."""
_PATTERNS = ("paper", "fine", "dense", "cells", "noise")
_HELD_OUT_PATTERNS = (*_PATTERNS, "stripes", "stripes")


def draw_scenario(number: int) -> Scenario:
    """Return a scenario by its number."""
    rng = np.random.default_rng([number, _FAMILY])
    height = float(rng.uniform(620, 980))
    belt = draw_belt(rng)
    values: dict[str, Any] = {
        "kind": _KINDS[number % len(_KINDS)],
        "seed": 1000 + number,
        "speckle": number % _WITHOUT_PATTERN != _WITHOUT_PATTERN - 1,
        "ambient": float(np.exp(rng.uniform(np.log(0.15), np.log(1.5)))),
        "gain_spread": float(rng.uniform(0, 0.1)),
        "rig": _draw_rig(number, height, belt["width_mm"], rng),
        "projector": draw_projector(number, height, belt["width_mm"], rng),
        "belt": belt,
        "heap": draw_heap(number, rng, held_out=number >= HELD_OUT),
        "module": _draw_module(rng),
        "sensor": draw_sensor(rng),
        "optics": {
            "psf_sigma_px": float(rng.uniform(0.45, 1.1)),
            "falloff": float(rng.choice([0.0, 2.0, 4.0])),
        },
        "faults": {"dust": _draw_dust(rng)},
    }
    return Scenario.model_validate(values)


def _draw_rig(number: int, height_mm: float, belt_mm: float, rng: np.random.Generator) -> dict[str, Any]:
    widths = [widths for first, widths in _WIDTHS_PX if first <= number][-1]
    width = int(rng.choice(widths))
    view = belt_mm * float(rng.uniform(0.8, 1.25)) * (0.5 if _CLOSE <= number < HELD_OUT else 1)
    held_out = number >= HELD_OUT
    return {
        "seed": 5000 + number,
        "scale": 1.0,
        "size_px": (width, round(width * float(rng.choice(_SHAPES)) / 2) * 2),
        "pitch_um": 1000 * SENSOR_MM / width,
        "focal_mm": SENSOR_MM * height_mm / view,
        "height_mm": height_mm,
        "tilt_deg": float(rng.choice([0.0, rng.uniform(9, 14) if held_out else rng.uniform(-8, 8)])),
        "yaw_deg": float(rng.choice([0.0, rng.uniform(-45, 45)])),
        **place_auxiliaries(height_mm, rng, held_out=held_out),
    }


def place_auxiliaries(height_mm: float, rng: np.random.Generator, *, held_out: bool) -> dict[str, Any]:
    """Return the place of the auxiliaries: all around, two of them in a line, or within a part of the circle."""
    count = int(rng.choice(_AUXILIARIES))
    part = _HELD_OUT_PART_DEG if held_out else _PART_DEG
    around = float(rng.choice([360.0, part])) if count <= _MOST_IN_PART or held_out else 360.0
    return {
        "auxiliaries": count,
        "around_deg": around,
        "baselines_mm": tuple((rng.uniform(0.24, 0.48, count) * height_mm).tolist()),
        "first_deg": float(rng.uniform(0, 360)),
    }


def draw_projector(number: int, height_mm: float, belt_mm: float, rng: np.random.Generator) -> dict[str, Any]:
    """Return the pattern, power, blur and place of a scenario's projector."""
    x, y = rng.uniform(-120, 120, 2)
    return {
        "seed": 100 + number,
        "pattern": str(rng.choice(_HELD_OUT_PATTERNS if number >= HELD_OUT else _PATTERNS)),
        "cell_px": float(rng.uniform(2, 4.5)),
        "position_mm": [float(x), float(y), height_mm * float(rng.uniform(0.95, 1.1))],
        "covers_mm": belt_mm * float(rng.uniform(1.0, 1.35)),
        "power": float(rng.uniform(6, 14)),
        "blur_px": float(rng.uniform(0.5, 1.2)),
    }


def draw_belt(rng: np.random.Generator) -> dict[str, Any]:
    """Return the cross-section, sag and reflectance of a belt, and the floor below it."""
    width = float(rng.uniform(650, 1000))
    return {
        "width_mm": width,
        "flat_mm": 0.375 * width,
        "wing_deg": float(rng.choice([0.0, 20.0, 25.0, 35.0])),
        "misaligned_mm": float(rng.uniform(-15, 15)),
        "sag_mm": float(rng.uniform(0, 6)),
        "reflectance": float(rng.uniform(0.04, 0.09)),
        "floor_mm": float(rng.uniform(250, 700)),
        "floor_reflectance": float(rng.uniform(0.1, 0.5)),
    }


def _draw_module(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "turn_deg": float(rng.uniform(-180, 180)),
        "x_mm": float(rng.uniform(-25, 25)),
        "y_mm": float(rng.uniform(-25, 25)),
        "reflectance": float(rng.uniform(0.3, 0.7)),
    }


def draw_sensor(rng: np.random.Generator) -> dict[str, Any]:
    """Return the colour, bits and noise of the cameras."""
    full_well = float(np.exp(rng.uniform(np.log(4000), np.log(20_000))))
    return {
        "colour": str(rng.choice(["grey", "grey", "grey", "demosaiced", "rgb"])),
        "bits": int(rng.choice([8, 8, 12])),
        "full_well_e": full_well,
        "electrons_at_1": 0.85 * full_well,
        "read_noise_e": float(rng.uniform(3, 12)),
    }


def _draw_dust(rng: np.random.Generator) -> list[dict[str, Any]]:
    """Return dust in the air before all cameras in a fifth of the scenarios, of any density."""
    dust = {"transmission": float(rng.uniform(0.5, 0.95)), "veil": float(rng.uniform(0.1, 0.6))}
    return [dust] if rng.random() < 0.2 else []


def locate_capture(number: int, cache: Path) -> Path:
    """Return the folder of a scenario's capture, or of a moving heap's captures, in their cache."""
    return cache / f"{number:04d}"


def render_scenario(number: int, cache: Path) -> Path:
    """Return the folder of a scenario's capture, rendered into the cache where it is not there yet."""
    folder = locate_capture(number, cache)
    render_once(draw_scenario(number), folder)
    return folder


def render_once(scenario: Scenario, folder: Path) -> None:
    """Render a scenario into a folder where it is not there yet."""
    if not (folder / "preview.png").is_file():  # written last
        simulate(scenario, folder, Silent())


def main(cache: Path, numbers: list[int]) -> None:
    """Render scenarios."""
    for number in numbers:
        render_scenario(number, cache)
        print(number, flush=True)


if __name__ == "__main__":
    import sys

    main(Path(sys.argv[1]), [*range(int(sys.argv[2]), int(sys.argv[3]))])
