"""What goes wrong in a plant: the standard preset on frames that were spoiled on purpose."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import cv2
import numpy as np

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.stereo.multiview.initialisation.depth_range import find_depth_range
from captures import Scene
from methods import run

Images = Mapping[str, np.ndarray]
Spoil = Callable[[Images, list[str]], dict[str, np.ndarray]]
"""Images by camera, and the cameras with the core first, to other images."""

SCENES = ("module", "belt_loaded")
NOTES = """\
The standard preset; the strip is an eighth of the rows, and counts among the pixels that ought to be measured; noise:
Gaussian, added so that the images' own becomes three times as much; the depth range is found in the spoiled frame."""
_STRIP = (0.45, 0.575)
"""Rows of an image that are blacked out."""
_NOISE = np.sqrt(8.0) * 1.5
"""Added to noise of 1.5 counts it makes three times as much; halving an image halves it."""
_RENDERED_WIDTH_PX = 1224
_SEED = 17


def _black(image: np.ndarray) -> np.ndarray:
    first, last = (round(edge * image.shape[0]) for edge in _STRIP)
    black = image.copy()
    black[first:last] = 0
    return black


def _noisy(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    sigma = _NOISE * image.shape[1] / _RENDERED_WIDTH_PX
    return np.clip(np.rint(image + rng.normal(0, sigma, image.shape)), 0, 255).astype(np.uint8)


def _noise(images: Images, _: list[str]) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(_SEED)
    return {name: _noisy(image, rng) for name, image in images.items()}


def _grey(image: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image


def _changed(change: Callable[[np.ndarray], np.ndarray], place: int) -> Spoil:
    """One camera's image changed; 0 is the core."""
    return lambda images, names: {**images, names[place]: change(images[names[place]])}


def _every(change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    return lambda images, _: {name: change(image) for name, image in images.items()}


def _darker(image: np.ndarray) -> np.ndarray:
    return np.rint(image * 0.8).astype(np.uint8)


def _defocused(image: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(image, (0, 0), 2.0)


FAULTS: Mapping[str, Spoil] = {
    "as it is": lambda images, _: dict(images),
    "a strip of one auxiliary black": _changed(_black, 1),
    "a strip of all images black": _every(_black),
    "an auxiliary 20 % darker": _changed(_darker, 1),
    "the core 20 % darker": _changed(_darker, 0),
    "an auxiliary out of focus (σ 2 px)": _changed(_defocused, 1),
    "the core out of focus (σ 2 px)": _changed(_defocused, 0),
    "noise × 3": _noise,
    "an auxiliary missing": lambda images, names: {n: i for n, i in images.items() if n != names[1]},
    "8 bit grey": _every(_grey),
    "16 bit": _every(lambda image: image.astype(np.uint16) * 257),
}


def robustness(scenes: list[Scene]) -> list[str]:
    """A row for every scene and fault; the depth range is found in the spoiled frame, too."""
    lines = [
        "| scene | size | fault | < 1 mm | measured | gross | median mm | P95 mm | σ ratio | over fifths |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for scene in scenes:
        names = [scene.rig.core, *scene.rig.auxiliaries]
        for fault, spoil in FAULTS.items():
            frame = FrameSet(scene.frame.frame, spoil(scene.frame.images, names))
            lines.append(
                f"| {scene.name} | {scene.size} | {fault} | {_figures(replace(scene, frame=frame))} |"
            )
    return lines


def _figures(scene: Scene) -> str:
    try:
        result = run("standard", scene, find_depth_range(scene.rig, scene.frame, Silent()), timed=False)
    except ReconstructionError as error:
        return f"refused: {error}" + " |" * 6
    s, (low, high) = result.score, result.compute_sigma_ratios
    return (
        f"{s.within_1mm:.2%} | {s.coverage:.2%} | {s.gross:.2%} | {s.interior_median_mm:.4f} | "
        f"{s.interior_p95_mm:.3f} | {s.sigma_ratio:.2f} | {low:.2f}–{high:.2f}"
    )
