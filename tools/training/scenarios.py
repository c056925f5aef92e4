"""The training scenarios: plants, materials and sensors drawn at random, each from its own seed.

Scenario i is drawn from the seed ``[i, 26]``: rig and projector, belt, heap or module, sensor. Numbers below
`HELD_OUT` are for training; those from there on are rendered to assess the networks and are never trained on.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.progress import Silent
from beltscape.pipeline.simulation import simulate
from beltscape.simulate.scenario import Scenario

HELD_OUT = 1000
"""Number of the first scenario that is not trained on."""
_FAMILY = 26
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
_SMALL, _HALF = 64, 0.5
"""Number of the first scenarios, of several sizes and mostly small, which are cheap; all further ones have half the
sensor's size, which is nearer to what plants use."""
_CLOSE, _CLOSER = 112, 2.0
"""First scenario with this many times longer lenses: at half the sensor's size their pixels are as large on the belt
as a full sensor's, for a quarter of its cost."""
_WITHOUT_SPECKLE = 11
"""Period of the scenarios whose projector is off: most surfaces that are found there are false."""


def draw_scenario(number: int) -> Scenario:
    """Return a scenario by its number."""
    rng = np.random.default_rng([number, _FAMILY])
    height = float(rng.uniform(620, 980))
    values: dict[str, Any] = {
        "kind": _KINDS[number % len(_KINDS)],
        "seed": 1000 + number,
        "speckle": number % _WITHOUT_SPECKLE != _WITHOUT_SPECKLE - 1,
        "ambient": float(rng.uniform(0.3, 1.5)),
        "gain_spread": float(rng.uniform(0, 0.1)),
        "rig": _draw_rig(number, height, rng),
        "projector": _draw_projector(number, height, rng),
        "belt": _draw_belt(rng),
        "heap": _draw_heap(number, rng),
        "module": _draw_module(rng),
        "sensor": _draw_sensor(rng),
        "optics": {
            "psf_sigma_px": float(rng.uniform(0.45, 1.0)),
            "falloff": float(rng.choice([0.0, 2.0, 4.0])),
        },
    }
    return Scenario.model_validate(values)


def _draw_rig(number: int, height_mm: float, rng: np.random.Generator) -> dict[str, Any]:
    scale = float(rng.choice([0.25, 0.25, 0.375, _HALF]))
    return {
        "seed": 5000 + number,
        "scale": max(scale, _HALF if _SMALL <= number < HELD_OUT else 0),
        "height_mm": height_mm,
        "auxiliaries": int(rng.choice([2, 3, 4, 4, 5])),
        "baseline_mm": float(rng.uniform(0.25, 0.48)) * height_mm,
        "first_deg": float(rng.uniform(0, 90)),
        "focal_mm": float(rng.uniform(7, 10)) * (_CLOSER if _is_close(number) else 1),
    }


def _is_close(number: int) -> bool:
    """Return whether a scenario has long lenses."""
    return _CLOSE <= number < HELD_OUT


def _draw_projector(number: int, height_mm: float, rng: np.random.Generator) -> dict[str, Any]:
    x, y = rng.uniform(-90, 90, 2)
    return {
        "seed": 100 + number,
        "pattern": str(rng.choice(["paper", "paper", "fine", "dense"])),
        "position_mm": [float(x), float(y), height_mm * float(rng.uniform(0.95, 1.1))],
        "covers_mm": float(rng.uniform(800, 1100)),
        "power": float(rng.uniform(6, 14)),
        "blur_px": float(rng.uniform(0.5, 1.2)),
    }


def _draw_belt(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "wing_deg": float(rng.choice([0.0, 20.0, 25.0, 35.0])),
        "misaligned_mm": float(rng.uniform(-15, 15)),
        "sag_mm": float(rng.uniform(0, 6)),
        "reflectance": float(rng.uniform(0.04, 0.09)),
    }


def _draw_heap(number: int, rng: np.random.Generator) -> dict[str, Any]:
    heap = _draw_rocks_and_fines(number, rng)
    if _is_close(number):
        heap["shapes"]["pressed"] = float(rng.choice([0.0, 0.0, 0.3, 1.0]))
        if heap["shapes"]["pressed"] == 1:
            heap["rocks"] = int(rng.choice([30, 150, 600, 1300]))
            heap["fines"]["crown_mm"] = float(rng.choice([0.0, 20.0, 60.0]))
    return heap


def _draw_rocks_and_fines(number: int, rng: np.random.Generator) -> dict[str, Any]:
    smallest = float(rng.uniform(5, 16))
    return {
        "seed": 300 + number,
        "rocks": int(rng.choice([0, 60, 300, 700, 1300, 1300, 1800])),
        "sizes": {
            "law": str(rng.choice(["rosin-rammler", "gaudin-schuhmann"])),
            "smallest_mm": smallest,
            "largest_mm": smallest + float(rng.uniform(15, 75)),
            "median_mm": smallest + float(rng.uniform(8, 45)),
            "exponent": float(rng.uniform(1.0, 3.0)),
        },
        "shapes": {"roughness": float(rng.uniform(0.01, 0.09)), "flattest": float(rng.uniform(0.4, 0.8))},
        "fines": {
            "crown_mm": float(rng.uniform(20, 120)),
            "crown_x_mm": float(rng.uniform(-60, 60)),
            "grain_mm": float(rng.choice([0.1, 0.4, 0.8, 1.5])),
            "waves_mm": float(rng.uniform(2, 10)),
        },
        "reflectance": float(np.exp(rng.uniform(np.log(0.04), np.log(0.4)))),
        "spread": float(rng.uniform(0.1, 0.5)),
        "mottle": float(rng.uniform(0.05, 0.3)),
    }


def _draw_module(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "turn_deg": float(rng.uniform(-180, 180)),
        "x_mm": float(rng.uniform(-25, 25)),
        "y_mm": float(rng.uniform(-25, 25)),
        "reflectance": float(rng.uniform(0.3, 0.7)),
    }


def _draw_sensor(rng: np.random.Generator) -> dict[str, Any]:
    full_well = float(np.exp(rng.uniform(np.log(4000), np.log(20_000))))
    return {
        "colour": str(rng.choice(["grey", "grey", "grey", "demosaiced", "rgb"])),
        "bits": int(rng.choice([8, 8, 12])),
        "full_well_e": full_well,
        "electrons_at_1": 0.85 * full_well,
        "read_noise_e": float(rng.uniform(3, 12)),
    }


def locate_capture(number: int, cache: Path) -> Path:
    """Return the folder of a scenario's capture in the cache."""
    return cache / f"{number:04d}"


def render_scenario(number: int, cache: Path) -> Path:
    """Return the folder of a scenario's capture, rendered into the cache where it is not there yet."""
    folder = locate_capture(number, cache)
    if not (folder / "preview.png").is_file():  # written last
        simulate(draw_scenario(number), folder, Silent())
    return folder


def main(cache: Path, numbers: list[int]) -> None:
    """Render scenarios."""
    for number in numbers:
        render_scenario(number, cache)
        print(number, flush=True)


if __name__ == "__main__":
    import sys

    main(Path(sys.argv[1]), [*range(int(sys.argv[2]), int(sys.argv[3]))])
