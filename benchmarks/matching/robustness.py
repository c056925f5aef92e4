"""Benchmark of robustness: the standard preset on frames with image faults that occur in a plant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import cv2
import numpy as np

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.stereo.multiview.depth_range import find_depth_range
from captures import Scene
from matching.methods import run

Images = Mapping[str, np.ndarray]
Degradation = Callable[[Images, list[str]], dict[str, np.ndarray]]
"""Maps images by camera, and the cameras' names with the core first, to degraded images."""

SCENES = ("module", "belt_loaded")
NOTES = """\
The standard preset; the strip is an eighth of the rows, and counts among the pixels that ought to be measured; noise:
Gaussian, added so that the images' own becomes three times as much; the depth range is found in the spoiled frame."""
_STRIP = (0.45, 0.575)
"""Range of the blackened rows, as shares of the height."""
_NOISE = np.sqrt(8.0) * 1.5
"""σ that triples a noise of 1.5 counts; halving an image halves it."""
_RENDERED_WIDTH_PX = 1224
_SEED = 17


def _blacken(image: np.ndarray) -> np.ndarray:
    first, last = (round(edge * image.shape[0]) for edge in _STRIP)
    black = image.copy()
    black[first:last] = 0
    return black


def _add_noise(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    sigma = _NOISE * image.shape[1] / _RENDERED_WIDTH_PX
    return np.clip(np.rint(image + rng.normal(0, sigma, image.shape)), 0, 255).astype(np.uint8)


def _triple_noise(images: Images, _: list[str]) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(_SEED)
    return {name: _add_noise(image, rng) for name, image in images.items()}


def _to_grey(image: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image


def _degrade_one(change: Callable[[np.ndarray], np.ndarray], place: int) -> Degradation:
    """Return a degradation of one camera's image; 0 is the core."""
    return lambda images, names: {**images, names[place]: change(images[names[place]])}


def _degrade_all(change: Callable[[np.ndarray], np.ndarray]) -> Degradation:
    return lambda images, _: {name: change(image) for name, image in images.items()}


def _darken(image: np.ndarray) -> np.ndarray:
    return np.rint(image * 0.8).astype(np.uint8)


def _defocus(image: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(image, (0, 0), 2.0)


FAULTS: Mapping[str, Degradation] = {
    "as it is": lambda images, _: dict(images),
    "a strip of one auxiliary black": _degrade_one(_blacken, 1),
    "a strip of all images black": _degrade_all(_blacken),
    "an auxiliary 20 % darker": _degrade_one(_darken, 1),
    "the core 20 % darker": _degrade_one(_darken, 0),
    "an auxiliary out of focus (σ 2 px)": _degrade_one(_defocus, 1),
    "the core out of focus (σ 2 px)": _degrade_one(_defocus, 0),
    "noise × 3": _triple_noise,
    "an auxiliary missing": lambda images, names: {n: i for n, i in images.items() if n != names[1]},
    "8 bit grey": _degrade_all(_to_grey),
    "16 bit": _degrade_all(lambda image: image.astype(np.uint16) * 257),
}


def robustness(scenes: list[Scene]) -> list[str]:
    """Return a row per scene and fault; the depth range is also found in the degraded frame."""
    lines = [
        "| scene | size | fault | < 1 mm | measured | gross | median mm | P95 mm | σ ratio | over fifths |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for scene in scenes:
        names = [scene.rig.core, *scene.rig.auxiliaries]
        for fault, degrade in FAULTS.items():
            frame = FrameSet(scene.frame.frame, degrade(scene.frame.images, names))
            lines.append(
                f"| {scene.name} | {scene.size} | {fault} | {_figures(replace(scene, frame=frame))} |"
            )
    return lines


def _figures(scene: Scene) -> str:
    try:
        result = run("standard", scene, find_depth_range(scene.rig, scene.frame, Silent()), timed=False)
    except ReconstructionError as error:
        return f"refused: {error}" + " |" * 6
    s, (low, high) = result.score, result.sigma_ratios
    return (
        f"{s.within_1mm:.2%} | {s.coverage:.2%} | {s.gross:.2%} | {s.interior_median_mm:.4f} | "
        f"{s.interior_p95_mm:.3f} | {s.sigma_ratio:.2f} | {low:.2f}–{high:.2f}"
    )
