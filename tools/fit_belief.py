"""Fit what is believed of a surface, confidence and sigma, to simulated captures with truth: data/belief.json.

    python tools/fit_belief.py CAPTURE…

Each CAPTURE is what ``beltscape simulate SCENE --out CAPTURE`` wrote: loaded belts, modules and empty belts, with
and without speckle, of several rigs, image sizes and seeds, with rough stones and with even ones: what is rougher
than the matcher's windows shows in no evidence, and sigma takes after the stones it was fitted to. Every capture is
matched with all its auxiliaries, with some and with one, by several presets, and as a plant might spoil it: noise, a
darker camera, one out of focus. A capture named twice counts twice: what ships had flat-faced stones and empty belts
as often as rough stones. Confidence goes on from the weights that ship, sigma begins anew. Judge the result on
captures that are not among them.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.linalg import block_diag

import beltscape
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.core.rig import Rig
from beltscape.evaluate.depth import interior_pixels
from beltscape.files.images import read_image
from beltscape.files.rig_json import read_rig
from beltscape.kernels import load
from beltscape.stereo.belief import fitted
from beltscape.stereo.evidence import evidence
from beltscape.stereo.multiview import MultiviewReconstructor
from beltscape.stereo.multiview_settings import MultiviewSettings
from beltscape.stereo.prepared import grid_unit
from beltscape.stereo.search import find_depth_range
from beltscape.stereo.sight import seen_by
from beltscape.stereo.windows import windows

GROSS_MM = 4.0
"""Farther off than that a surface is false."""
ALONG_MM = 240.0
"""The projector lights little more of the belt."""
ON_FAILURE_MM = (560.0, 800.0)
"""Depth range of captures that show nothing, which are to be learnt from as well."""
SAMPLES = 20_000
"""Of a match's own scene; of the belt beside it a third of that."""
UNITS, SIGMA_UNITS = 72, 32
EPOCHS, BATCH, DECAY = 14, 4096, 1e-5
RATE, RATE_ON = 5e-3, 3e-3
"""Of the descent, from chance weights and from fitted ones."""
UNSEEN = 2.0
"""What a pixel that no auxiliary sees counts for in confidence: they are few, and most false fill."""
NEAR = 0.1
"""What a pixel near a true step counts for in sigma."""
LIMIT = 4.0
"""Evidence is clamped to so many standard deviations about its mean."""
BELIEVED = 0.6
"""Sigma is fitted to pixels of at least this confidence ..."""
MOST_MM = 5.0
"""... and no greater error: what is false is confidence's to tell."""
MAD = 1.4826
"""Sigma over the median error, of a normal distribution."""
ROUND = 0.1
"""About its corner the absolute error's logarithm is bent as a parabola."""


@dataclass(frozen=True)
class Sample:
    """Evidence and errors of a match's pixels."""

    names: tuple[str, ...]
    evidence: np.ndarray
    dz_mm: np.ndarray
    ds_px: np.ndarray
    interior: np.ndarray
    """Of pixels away from true steps."""
    unseen: np.ndarray
    """Of pixels that no auxiliary truly sees."""


def samples(folder: Path) -> Iterator[Sample]:
    """A capture's matches."""
    rig = read_rig(folder / "truth" / "rig.json")
    truth = np.load(next((folder / "truth").glob("*_depth.npz")))
    images = {name: read_image(next((folder / name).glob("000.*"))) for name in rig.cameras}
    every = rig.auxiliaries
    for names, preset, spoil in (
        (every, "standard", same),
        (every[:3], "standard", same),
        (every[1::2], "standard", same),
        (every[:1], "standard", same),
        (every, "fast", same),
        (every, "fine", same),
        (every, "standard", noisy),
        (every, "fast", uneven),
        (every[:2], "standard", blurred),
        (every, "standard", strangers),
        (every, "standard", blank),
        (every[:2], "standard", strangers),
        (every, "fast", blank),
    ):
        frame = FrameSet("000", spoil({name: images[name] for name in (rig.core, *names)}))
        sample = _sample(rig, frame, names, MultiviewSettings.preset(preset), truth)
        if spoil in (strangers, blank):  # what is right there is right by chance
            sample = replace(sample, dz_mm=np.full_like(sample.dz_mm, np.inf))
        yield sample


def same(images: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """As they were taken."""
    return images


def noisy(images: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """With more noise than a sensor has."""
    rng = np.random.default_rng(1)
    return {name: _pixels(image + rng.normal(0, 4, image.shape), image) for name, image in images.items()}


def uneven(images: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """One auxiliary darker than the others, and noise."""
    rng = np.random.default_rng(2)
    last = list(images)[-1]
    return {
        name: _pixels(image * (0.7 if name == last else 1) + rng.normal(0, 2, image.shape), image)
        for name, image in images.items()
    }


def blurred(images: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """One auxiliary out of focus."""
    last = list(images)[-1]
    return {name: cv2.GaussianBlur(i, (0, 0), 2.0) if name == last else i for name, i in images.items()}


def strangers(images: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The auxiliaries see another scene."""
    core = next(iter(images))
    return {name: i if name == core else np.ascontiguousarray(i[::-1, ::-1]) for name, i in images.items()}


def blank(images: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Nothing to see: even grey at the top, darkening downwards, and black at the bottom; with noise."""
    rng = np.random.default_rng(3)

    def one(image: np.ndarray) -> np.ndarray:
        shade = np.interp(np.linspace(0, 1, len(image)), (0, 0.4, 0.8, 0.8001, 1), (90, 90, 20, 0, 0))
        shape = (-1, *[1] * (image.ndim - 1))
        return _pixels(shade.reshape(shape) + rng.normal(0, 1.5, image.shape), image)

    return {name: one(image) for name, image in images.items()}


def _pixels(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0, np.iinfo(like.dtype).max).astype(like.dtype)


def _sample(
    rig: Rig,
    frame: FrameSet,
    names: tuple[str, ...],
    settings: MultiviewSettings,
    truth: np.lib.npyio.NpzFile,
) -> Sample:
    try:
        near_far = find_depth_range(rig, frame, Silent())
    except ReconstructionError:
        near_far = ON_FAILURE_MM
    match = MultiviewReconstructor(rig, near_far, settings, auxiliaries=names).match(frame, names, Silent())
    step = settings.step(rig.core_camera.size_px[0])
    surface = match.refined.surface
    s = surface.s
    height, width = s.shape
    inside = slice(step // 2, height * step, step), slice(step // 2, width * step, step)
    true_mm, label = truth["depth_mm"][inside], truth["label"][inside]
    rays = rig.core_camera.rays()[inside]
    scene = label >= 10 if (label >= 10).any() else label == (2 if (label == 2).any() else 1)
    seen = seen_by(s, match.prepared.views, match.prepared.sizes, load())
    use = (np.abs(rays[..., 1] * true_mm) <= ALONG_MM) & (seen > 0) & np.isfinite(s)
    beside = use & ~scene & ((label == 1) | (label == 2))
    listed = list(evidence(match.chosen, match.refined, match.prepared, seen, windows(width).scale))
    unit = grid_unit(rig, names, step)
    rng = np.random.default_rng(0)
    chosen = np.concatenate([
        rng.permutation(np.flatnonzero(where))[:most]
        for where, most in ((use & scene, SAMPLES), (beside, SAMPLES // 3))
    ])  # fmt: skip
    beside_px = (
        step // 2 - (step - 1) / 2
    ) / step  # of the pixel whose truth is taken, off its block's centre
    at_pixel = s + beside_px * (surface.slope_u + surface.slope_v)
    found, true = at_pixel.ravel()[chosen].astype(float), true_mm.ravel()[chosen].astype(float)
    return Sample(
        tuple(name for name, _ in listed),
        np.stack([np.asarray(value).ravel()[chosen] for _, value in listed], axis=-1).astype(np.float32),
        1 / (found * unit) - true,
        found - 1 / (true * unit),
        interior_pixels(truth["depth_mm"].astype(float))[inside].ravel()[chosen],
        truth["views"][inside].ravel()[chosen] == 0,
    )


Layers = tuple[np.ndarray, np.ndarray]
"""Hidden and output."""
Slope = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Answers and targets (n,) → of the loss by the answer, (n,)."""


def of_right(answer: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Of the cross-entropy: the answer becomes the logit of what share is right."""
    return 1 / (1 + np.exp(-answer)) - right


def of_size(answer: np.ndarray, log_size: np.ndarray) -> np.ndarray:
    """Of the absolute deviation: the answer becomes the median of the logarithm, whatever lies far off."""
    return np.clip((answer - log_size) / ROUND, -1, 1)


def limits_of(x: np.ndarray) -> np.ndarray:
    """(2, n) beyond which evidence (N, n) is rare, and says no more."""
    mean, spread = x.mean(axis=0, dtype=float), x.std(axis=0, dtype=float)
    low, high = mean - LIMIT * spread, mean + LIMIT * spread
    return np.stack([np.maximum(low, x.min(axis=0)), np.minimum(high, x.max(axis=0))])


def fit(
    x: np.ndarray,
    limits: np.ndarray,
    target: np.ndarray,
    slope: Slope,
    weight: np.ndarray,
    start: Layers,
    rate: float,
) -> Layers:
    """Layers that bring the answers to evidence within its limits to the targets."""
    mean, spread = x.mean(axis=0, dtype=float), x.std(axis=0, dtype=float) + 1e-6
    within = ((np.clip(x, *limits) - mean) / spread).astype(np.float32)
    hidden, output = (layer.astype(float) for layer in start)
    hidden[:, -1] += hidden[:, :-1] @ mean
    hidden[:, :-1] *= spread
    descend(hidden, output, within, target, slope, weight / weight.mean(), rate)
    hidden[:, -1] -= hidden[:, :-1] @ (mean / spread)
    hidden[:, :-1] /= spread
    return hidden, output


def descend(
    hidden: np.ndarray,
    output: np.ndarray,
    x: np.ndarray,
    target: np.ndarray,
    slope: Slope,
    weight: np.ndarray,
    rate: float,
) -> None:
    """Layers for evidence in standard units, in place."""
    rng = np.random.default_rng(0)
    descent = Adam(hidden), Adam(output)
    batches = len(x) // BATCH
    for epoch in range(EPOCHS):
        order = rng.permutation(len(x))
        for i in range(batches):
            batch = order[i * BATCH : (i + 1) * BATCH]
            left = 1 - (epoch * batches + i) / (EPOCHS * batches)
            slopes = _gradients(hidden, output, x[batch], target[batch], slope, weight[batch])
            for one, down in zip(descent, slopes, strict=True):
                one.step(down, rate * left)
        print(f"epoch {epoch + 1} of {EPOCHS}", file=sys.stderr)


def anew(x: np.ndarray, target: np.ndarray, units: int) -> Layers:
    """By chance, for evidence in its own units; the answer begins at the targets' median."""
    rng = np.random.default_rng(0)
    n = x.shape[1]
    mean, spread = x.mean(axis=0, dtype=float), x.std(axis=0, dtype=float) + 1e-6
    hidden = np.hstack([rng.normal(0, (2 / n) ** 0.5, (units, n)) / spread, np.zeros((units, 1))])
    hidden[:, -1] = -hidden[:, :-1] @ mean
    return hidden, np.append(rng.normal(0, units**-0.5, units), np.median(target))[None]


def shipped(names: tuple[str, ...], x: np.ndarray) -> Layers:
    """Confidence's part of the weights that ship, new units and new evidence without a say yet."""
    belief = fitted()
    own = np.flatnonzero(belief.output[0, :-1])[:UNITS]
    hidden, output = anew(x, np.zeros(1), UNITS)
    output[0, :-1], output[0, -1] = 0, belief.output[0, -1]
    output[0, : len(own)] = belief.output[0, own]
    hidden[: len(own)] = 0
    hidden[: len(own), -1] = belief.hidden[own, -1]
    for column, name in enumerate(names):
        if name in belief.names:
            hidden[: len(own), column] = belief.hidden[own, belief.names.index(name)]
    return hidden, output


def answers(x: np.ndarray, limits: np.ndarray, hidden: np.ndarray, output: np.ndarray) -> np.ndarray:
    """(n,) of a network with one."""
    units = np.maximum(np.clip(x, *limits) @ hidden[:, :-1].T + hidden[:, -1], 0)
    return units @ output[0, :-1] + output[0, -1]


class Adam:
    """One layer's way down, in place (Kingma & Ba, arXiv:1412.6980)."""

    def __init__(self, weights: np.ndarray) -> None:
        self._weights, self._count = weights, 0
        self._mean, self._square = np.zeros_like(weights), np.zeros_like(weights)

    def step(self, slope: np.ndarray, rate: float) -> None:
        """Against the slope of the loss."""
        self._count += 1
        self._mean += 0.1 * (slope - self._mean)
        self._square += 0.001 * (slope * slope - self._square)
        mean, square = self._mean / (1 - 0.9**self._count), self._square / (1 - 0.999**self._count)
        self._weights -= rate * (mean / (np.sqrt(square) + 1e-8) + DECAY * self._weights)


def _gradients(
    hidden: np.ndarray,
    output: np.ndarray,
    x: np.ndarray,
    target: np.ndarray,
    slope: Slope,
    weight: np.ndarray,
) -> Layers:
    """Of the mean loss."""
    one = np.ones((len(x), 1))
    x = np.hstack([x, one])
    units = np.maximum(x @ hidden.T, 0)
    answer = (np.hstack([units, one]) @ output.T)[:, 0]
    pull = (weight * slope(answer, target))[:, None] / len(x)
    back = (pull @ output[:, :-1]) * (units > 0)
    return back.T @ x, pull.T @ np.hstack([units, one])


def main() -> None:
    """Match, fit both networks, write them as one."""
    found = [sample for folder in sys.argv[1:] for sample in samples(Path(folder))]
    names = found[0].names
    x = np.concatenate([sample.evidence for sample in found])
    dz, ds = (np.abs(np.concatenate([getattr(s, field) for s in found])) for field in ("dz_mm", "ds_px"))
    limits = limits_of(x)
    weight = np.where(np.concatenate([sample.unseen for sample in found]), UNSEEN, 1)
    belief = fit(x, limits, dz <= GROSS_MM, of_right, weight, shipped(names, x), RATE_ON)
    known = (answers(x, limits, *belief) > np.log(BELIEVED / (1 - BELIEVED))) & (dz <= MOST_MM)
    sizes = np.log(MAD * np.maximum(ds[known], 1e-6))
    weight = np.where(np.concatenate([sample.interior for sample in found])[known], 1, NEAR)
    size = names.index("size")  # told it, sigma would learn single captures of that size
    shape = np.delete(x[known], size, axis=1)
    start = anew(shape, sizes, SIGMA_UNITS)
    units, output = fit(shape, np.delete(limits, size, axis=1), sizes, of_size, weight, start, RATE)
    sigma = np.insert(units, size, 0, axis=1), output
    hidden, outputs = zip(belief, sigma, strict=True)
    constants = np.concatenate([output[:, -1:] for output in outputs])
    output = np.hstack([block_diag(*(output[:, :-1] for output in outputs)), constants])
    write(names, {"limits": limits, "hidden": np.concatenate(hidden), "output": output})


def write(names: tuple[str, ...], parts: dict[str, np.ndarray]) -> None:
    """data/belief.json, a row a line."""
    rows = {part: [[float(f"{value:.6g}") for value in row] for row in rows] for part, rows in parts.items()}
    kept = {"names": names, **rows}
    text = (f'"{part}": [\n' + ",\n".join(map(json.dumps, kept[part])) + "\n]" for part in kept)
    path = Path(beltscape.__file__).parent / "data" / "belief.json"
    path.write_text("{" + ",\n".join(text) + "}\n", "utf-8")


if __name__ == "__main__":
    main()
