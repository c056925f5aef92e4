"""The moving heaps that the network of holes is fitted to: materials, layers and rigs drawn at random.

Heap i is drawn from the seed ``[i, 28]``. What a frame of it, and no frame, measures depends on how its bodies lie,
so their bedding, and the choice they had when they fell, are drawn as well. Heaps from `HELD_OUT` on are never
fitted to.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from beltscape.simulate.scenario import Scenario
from training.materials import MIXTURES, Heap
from training.scenarios import (
    HELD_OUT,
    SENSOR_MM,
    draw_belt,
    draw_projector,
    draw_sensor,
    locate_capture,
    place_auxiliaries,
    render_once,
)

MOVING, EMPTY = "moving", "empty"
"""Folders of the moving heap, and of its empty belt."""
_FAMILY = 28
"""Second part of every seed: another value gives other heaps."""
MATERIALS = (
    "stones",
    "stones",
    "layers",
    "layers",
    "blocks",
    "stones",
    "layers",
    "pellets",
    "stones",
    "deep layers",
)
"""Materials in turn: large stones on fines, and several layers of smaller ones, differ most."""


def draw_heap_in_motion(number: int, kind: str) -> Scenario:
    """Return the scenario of a heap, ``belt_moving``, or of its empty belt, ``belt_empty``."""
    rng = np.random.default_rng([number, _FAMILY])
    height = float(rng.uniform(620, 980))
    belt = draw_belt(rng)
    width = int(rng.choice([400, 480, 612]))
    view = belt["width_mm"] * float(rng.uniform(0.85, 1.15))
    values: dict[str, Any] = {
        "kind": kind,
        "seed": 7000 + number + (HELD_OUT if kind == "belt_empty" else 0),
        "frames": 1 if kind == "belt_empty" else None,
        "ambient": float(np.exp(rng.uniform(np.log(0.15), np.log(0.8)))),
        "rig": {
            "seed": 9000 + number,
            "scale": 1.0,
            "size_px": (width, round(width * 5 / 12) * 2),
            "pitch_um": 1000 * SENSOR_MM / width,
            "focal_mm": SENSOR_MM * height / view,
            "height_mm": height,
            "tilt_deg": float(rng.choice([0.0, rng.uniform(-6, 6)])),
            **place_auxiliaries(height, rng, held_out=False),
        },
        "projector": draw_projector(number, height, belt["width_mm"], rng),
        "belt": belt,
        "heap": {"seed": 600 + number, **_draw_heap(number, rng)},
        "sensor": draw_sensor(rng),
        "motion": {"speed_mm_s": 1000.0, "frames_per_s": float(rng.uniform(3.0, 6.5))},
    }
    return Scenario.model_validate(values)


def _draw_heap(number: int, rng: np.random.Generator) -> Heap:
    """Return a heap some half a metre long, whose bodies lie closely or loosely, on fines or in them."""
    heap = MIXTURES[MATERIALS[number % len(MATERIALS)]](rng)
    half = float(rng.uniform(180, 330))
    heap["fines"] |= {"along_mm": (-half, half), "crown_mm": float(rng.uniform(40, 110))}
    return heap | {
        "bedding": float(rng.choice([0.0, 0.15, rng.uniform(0, 0.3)])),
        "candidates": int(rng.choice([1, 2, 6, 6])),
    }


def render_heap(number: int, cache: Path) -> Path:
    """Return the folder of a heap's captures, rendered into the cache where they are not there yet."""
    folder = locate_capture(number, cache)
    for name, kind in ((EMPTY, "belt_empty"), (MOVING, "belt_moving")):
        render_once(draw_heap_in_motion(number, kind), folder / name)
    return folder
