"""Fit what is believed of a surface to simulated captures with truth: data/belief.json, the weights of sigma.

    python tools/fit_belief.py CAPTURE…

Each CAPTURE is what ``beltscape simulate SCENE --out CAPTURE`` wrote: loaded belts, modules and empty belts, with
and without speckle, of several rigs, sizes and seeds. Every capture is matched with all its auxiliaries,
with some and with one, by several presets, and as a plant might spoil it: noise, a darker camera, one out of focus.
Judge the result on captures that are not among them.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

import beltscape
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.core.rig import Rig
from beltscape.files.images import read_image
from beltscape.files.rig_json import read_rig
from beltscape.kernels import load
from beltscape.stereo.evidence import evidence
from beltscape.stereo.judge import SIGMA_WEIGHTS
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
SAMPLES = 30_000
UNITS, EPOCHS, BATCH, RATE, DECAY = 32, 16, 2048, 3e-3, 1e-5
LIMIT = 4.0
"""Evidence is clamped to so many standard deviations about its mean."""
BELIEVED = 0.8
"""Sigma is fitted to pixels of at least this confidence."""


@dataclass(frozen=True)
class Sample:
    """Evidence and errors of a match's pixels."""

    names: tuple[str, ...]
    evidence: np.ndarray
    dz_mm: np.ndarray
    ds_px: np.ndarray


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
    s = match.refined.surface.s
    height, width = s.shape
    inside = slice(step // 2, height * step, step), slice(step // 2, width * step, step)
    true_mm, label = truth["depth_mm"][inside], truth["label"][inside]
    rays = rig.core_camera.rays()[inside]
    scene = label >= 10 if (label >= 10).any() else label == (2 if (label == 2).any() else 1)
    seen = seen_by(s, match.prepared.views, match.prepared.sizes, load())
    use = scene & (np.abs(rays[..., 1] * true_mm) <= ALONG_MM) & (seen > 0) & np.isfinite(s)
    listed = list(evidence(match.chosen, match.refined, match.prepared, seen, windows(width).scale))
    unit = grid_unit(rig, names, step)
    chosen = np.random.default_rng(0).permutation(np.flatnonzero(use))[:SAMPLES]
    found, true = s.ravel()[chosen].astype(float), true_mm.ravel()[chosen].astype(float)
    return Sample(
        tuple(name for name, _ in listed),
        np.stack([np.asarray(value).ravel()[chosen] for _, value in listed], axis=-1).astype(np.float32),
        1 / (found * unit) - true,
        found - 1 / (true * unit),
    )


def fit(x: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hidden and output layer for evidence in standard units, to the likelihood of ``right``."""
    rng = np.random.default_rng(0)
    n = x.shape[1]
    hidden, output = rng.normal(0, (2 / n) ** 0.5, (UNITS, n + 1)), rng.normal(0, UNITS**-0.5, (1, UNITS + 1))
    hidden[:, -1] = output[:, -1] = 0
    descent = Adam(hidden), Adam(output)
    batches = len(x) // BATCH
    for epoch in range(EPOCHS):
        order = rng.permutation(len(x))
        for i in range(batches):
            batch = order[i * BATCH : (i + 1) * BATCH]
            rate = RATE * (1 - (epoch * batches + i) / (EPOCHS * batches))
            slopes = _gradients(hidden, output, x[batch], right[batch])
            for one, slope in zip(descent, slopes, strict=True):
                one.step(slope, rate)
        print(f"epoch {epoch + 1} of {EPOCHS}", file=sys.stderr)
    return hidden, output


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
    hidden: np.ndarray, output: np.ndarray, x: np.ndarray, right: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Of the mean cross-entropy."""
    one = np.ones((len(x), 1))
    x = np.hstack([x, one])
    units = np.maximum(x @ hidden.T, 0)
    pull = (1 / (1 + np.exp(-np.hstack([units, one]) @ output.T)) - right[:, None]) / len(x)
    back = (pull @ output[:, :-1]) * (units > 0)
    return back.T @ x, pull.T @ np.hstack([units, one])


def sigma_weights(x: np.ndarray, size_px: np.ndarray) -> np.ndarray:
    """Median regression of the logarithm of the error, by reweighted least squares; σ is 1.4826 medians."""
    y = np.log(size_px + 1e-4)
    w = np.linalg.lstsq(x, y)[0]
    for _ in range(60):
        weight = 1 / np.maximum(np.abs(y - x @ w), 0.02)
        w = np.linalg.solve((x * weight[:, None]).T @ x, (x * weight[:, None]).T @ y)
    w[-1] += np.log(1.4826)
    return w


def main() -> None:
    """Match, fit, write data/belief.json, print the weights of sigma."""
    found = [sample for folder in sys.argv[1:] for sample in samples(Path(folder))]
    names = found[0].names
    x = np.concatenate([sample.evidence for sample in found])
    dz, ds = (np.abs(np.concatenate([getattr(s, field) for s in found])) for field in ("dz_mm", "ds_px"))
    mean, spread = x.mean(axis=0, dtype=float), x.std(axis=0, dtype=float) + 1e-6
    low, high = (
        np.maximum(mean - LIMIT * spread, x.min(axis=0)),
        np.minimum(mean + LIMIT * spread, x.max(axis=0)),
    )
    hidden, output = fit((np.clip(x, low, high) - mean) / spread, dz <= GROSS_MM)
    hidden[:, -1] -= hidden[:, :-1] @ (mean / spread)
    hidden[:, :-1] /= spread
    write(names, {"limits": np.stack([low, high]), "hidden": hidden, "output": output})
    logit = (
        np.maximum(np.clip(x, low, high) @ hidden[:, :-1].T + hidden[:, -1], 0) @ output[0, :-1]
        + output[0, -1]
    )
    known = (logit > np.log(BELIEVED / (1 - BELIEVED))) & (dz <= GROSS_MM)
    columns = [names.index(name) for name in SIGMA_WEIGHTS]
    inputs = np.column_stack([x[known][:, columns], np.ones(known.sum())])
    weights = sigma_weights(inputs, ds[known])
    print(
        {
            name: round(float(w), 3)
            for name, w in zip([*(names[i] for i in columns), "constant"], weights, strict=True)
        }
    )


def write(names: tuple[str, ...], parts: dict[str, np.ndarray]) -> None:
    """data/belief.json, a row a line."""
    rows = {part: [[float(f"{value:.6g}") for value in row] for row in rows] for part, rows in parts.items()}
    kept = {"names": names, **rows}
    text = (f'"{part}": [\n' + ",\n".join(map(json.dumps, kept[part])) + "\n]" for part in kept)
    path = Path(beltscape.__file__).parent / "data" / "belief.json"
    path.write_text("{" + ",\n".join(text) + "}\n", "utf-8")


if __name__ == "__main__":
    main()
