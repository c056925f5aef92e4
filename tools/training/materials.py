"""Materials of the training scenarios: what lies on the belt, from broken stones to pellets and wet coal."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

Heap = dict[str, Any]


def draw_heap(number: int, rng: np.random.Generator, *, held_out: bool) -> Heap:
    """Return the heap of a scenario, of a material drawn at random; rods lie in scenarios that are held out only."""
    material = str(rng.choice(_HELD_OUT if held_out else _TRAINED))
    return {"seed": 300 + number, **MIXTURES[material](rng)}


def _draw_stones(rng: np.random.Generator) -> Heap:
    """Return broken stones of any size, many or few, rough or smooth, dark or bright."""
    smallest = float(rng.uniform(5, 16))
    heap = _bed(rng, rocks=int(rng.choice([60, 300, 700, 1300, 1300, 1800])))
    heap["sizes"] = {
        "law": str(rng.choice(["rosin-rammler", "gaudin-schuhmann"])),
        "smallest_mm": smallest,
        "largest_mm": smallest + float(rng.uniform(15, 75)),
        "median_mm": smallest + float(rng.uniform(8, 45)),
        "exponent": float(rng.uniform(1.0, 3.0)),
    }
    heap["shapes"] = {"roughness": float(rng.uniform(0.01, 0.09)), "flattest": float(rng.uniform(0.4, 0.8))}
    return heap


def _draw_layers(rng: np.random.Generator) -> Heap:
    """Return several layers of stones, most of them small."""
    smallest = float(rng.uniform(6, 12))
    heap = _draw_stones(rng) | {"rocks": int(rng.choice([800, 1500, 2500]))}
    heap["sizes"] |= {
        "smallest_mm": smallest,
        "largest_mm": smallest + float(rng.uniform(25, 70)),
        "median_mm": smallest + float(rng.uniform(4, 14)),
    }
    return heap


def _draw_deep_layers(rng: np.random.Generator) -> Heap:
    """Return many layers of small stones with some large ones."""
    return _draw_layers(rng) | {"rocks": int(rng.choice([2500, 3500, 4500]))}


def _draw_fines(rng: np.random.Generator) -> Heap:
    """Return fines with hardly a stone."""
    return _draw_stones(rng) | {"rocks": int(rng.choice([0, 20]))}


def _draw_wet_coal(rng: np.random.Generator) -> Heap:
    """Return dark, glossy stones."""
    wet = {"reflectance": float(rng.uniform(0.03, 0.07)), "gloss": float(rng.uniform(0.1, 0.5))}
    return _draw_stones(rng) | wet


def _draw_blocks(rng: np.random.Generator) -> Heap:
    """Return slabs, briquettes or blocks with plane faces and vertical sides, alone or among stones."""
    shapes = {
        "pressed": float(rng.choice([0.4, 1.0, 1.0])),
        "forms": [["cuboid"], ["cuboid", "cylinder"], ["cuboid", "ellipsoid"]][int(rng.integers(3))],
        "flattest": float(rng.uniform(0.3, 0.9)),
        "longest": float(rng.uniform(1.2, 2.5)),
        "roughness": float(rng.uniform(0.01, 0.05)),
    }
    heap = _bed(rng, rocks=int(rng.choice([30, 100, 300, 600])))
    heap["sizes"] = _draw_sizes(rng, (8, 25), (10, 45))
    return heap | {"shapes": shapes, "gloss": _draw_gloss(rng)}


def _draw_rods(rng: np.random.Generator) -> Heap:
    """Return long round bodies among slabs."""
    shapes = {"pressed": 1.0, "forms": ["cylinder", "cuboid"], "longest": 3.0, "flattest": 0.35}
    heap = _bed(rng, rocks=int(rng.choice([60, 150, 300]))) | {"shapes": shapes, "gloss": _draw_gloss(rng)}
    heap["sizes"] = _draw_sizes(rng, (8, 18), (10, 30))
    return heap


def _draw_pellets(rng: np.random.Generator) -> Heap:
    """Return several layers of small, round, often glossy bodies of nearly one size."""
    smallest = float(rng.uniform(7, 12))
    heap = _bed(rng, rocks=int(rng.choice([3000, 5000, 7000])))
    heap["sizes"] = {
        "smallest_mm": smallest,
        "largest_mm": smallest * float(rng.uniform(1.3, 1.8)),
        "median_mm": smallest * 1.2,
    }
    heap["shapes"] = {
        "pressed": 1.0,
        "forms": ["ellipsoid"],
        "longest": float(rng.uniform(1.0, 1.2)),
        "flattest": float(rng.uniform(0.85, 1.0)),
    }
    return heap | {"gloss": _draw_gloss(rng), "mottle": float(rng.uniform(0.0, 0.15))}


def _draw_grain(rng: np.random.Generator) -> Heap:
    """Return grain: small long bodies on fines as rough as they are."""
    heap = _bed(rng, rocks=int(rng.choice([4000, 7000])))
    heap["sizes"] = {"smallest_mm": 4.0, "largest_mm": float(rng.uniform(5.5, 8)), "median_mm": 5.0}
    heap["shapes"] = {"pressed": 1.0, "forms": ["ellipsoid"], "longest": float(rng.uniform(1.5, 2.5))}
    heap["fines"]["grain_mm"] = float(rng.uniform(0.8, 1.5))
    return heap | {"reflectance": float(rng.uniform(0.15, 0.45)), "gloss": float(rng.choice([0.0, 0.2]))}


def _bed(rng: np.random.Generator, rocks: int) -> Heap:
    """Return the fines below the bodies, and the reflectance of both."""
    return {
        "rocks": rocks,
        "fines": {
            "crown_mm": float(rng.uniform(10, 120)),
            "crown_x_mm": float(rng.uniform(-60, 60)),
            "grain_mm": float(rng.choice([0.1, 0.4, 0.8, 1.5])),
            "waves_mm": float(rng.uniform(2, 10)),
        },
        "reflectance": float(np.exp(rng.uniform(np.log(0.04), np.log(0.4)))),
        "spread": float(rng.uniform(0.1, 0.5)),
        "mottle": float(rng.uniform(0.05, 0.3)),
    }


def _draw_sizes(
    rng: np.random.Generator, smallest_mm: tuple[float, float], range_mm: tuple[float, float]
) -> dict[str, float]:
    smallest = float(rng.uniform(*smallest_mm))
    largest = smallest + float(rng.uniform(*range_mm))
    return {"smallest_mm": smallest, "largest_mm": largest, "median_mm": 0.5 * (smallest + largest)}


def _draw_gloss(rng: np.random.Generator) -> float:
    """Return the gloss: none in half of the cases."""
    return float(rng.choice([0.0, rng.uniform(0.1, 0.8)]))


MIXTURES: dict[str, Callable[[np.random.Generator], Heap]] = {
    "stones": _draw_stones,
    "layers": _draw_layers,
    "deep layers": _draw_deep_layers,
    "fines": _draw_fines,
    "wet coal": _draw_wet_coal,
    "blocks": _draw_blocks,
    "rods": _draw_rods,
    "pellets": _draw_pellets,
    "grain": _draw_grain,
}
_TRAINED = (
    "stones",
    "stones",
    "stones",
    "fines",
    "wet coal",
    "blocks",
    "blocks",
    "pellets",
    "pellets",
    "grain",
)
_HELD_OUT = ("rods", "rods", "stones", "pellets")
