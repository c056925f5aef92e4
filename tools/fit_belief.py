"""Fit what is believed of surfaces to simulated captures with truth.

    python tools/fit_belief.py impression|rivals|duel|belief|sigma|glance CAPTURE…

Each CAPTURE is what ``beltscape simulate SCENE --out CAPTURE`` wrote: loaded belts, modules and empty belts, with
and without speckle, of several rigs, image sizes and seeds, with rough stones and with even ones. Every capture is
matched as it is and as a plant might spoil it (tools/lessons.py); one named twice counts twice, spoiled in other
ways. The first four rest on each other in this order, and fit_scrutiny.py on them; ``sigma`` fits anew what
``belief`` says of sigma, and nothing else; ``glance`` is for the preset ``fast``. Each is written to a file of its
name in data/. Judge the result on captures that are not among them.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

import beltscape
from adam import Schedule, Slopes, fitted
from beltscape.stereo.multiview.networks import load_network
from samples import Sample, contests, pixels

GROSS_MM = 4.0
"""Farther off than that a surface is false."""
RIGHT_PX = 1.25
"""A rival so close to the truth is right, at scale 1."""
NEAR = 0.1
"""What a pixel near a true step counts for in sigma."""
LIMIT = 4.0
"""Evidence is clamped to so many standard deviations about its mean."""
BELIEVED = 0.75
"""Sigma is fitted to pixels of at least this confidence ..."""
MOST_MM = 5.0
"""... and no greater error: what is false is confidence's to tell."""
MAD = 1.4826
"""Sigma over the median error, of a normal distribution."""
ROUND = 0.1
"""About its corner the absolute error's logarithm is bent as a parabola."""


class Plan(NamedTuple):
    """Of a network's fit."""

    hidden: tuple[int, ...]
    epochs: int = 16
    batch: int = 8192
    unseen: float = 4.0
    """What a pixel that no auxiliary sees counts for: they are few, and what is right there is a guess."""


PLANS = {
    "impression": Plan((32,)),
    "rivals": Plan((32,)),
    "duel": Plan((64, 32), epochs=32, batch=4096),
    "belief": Plan((32,)),
    "glance": Plan((64,)),
    "sigma": Plan((32,)),
}
RATE = 4e-3


def fit_rivals(folders: list[Path]) -> None:
    """The logit of a rival's being right."""
    evidence, right = [], []
    for contest in contests(folders):
        for _, found, told, ds in contest.taken():
            known = np.isfinite(found.s)
            evidence.append(np.stack([plane[known] for plane in told.values()], -1).astype(np.float32))
            right.append(np.abs(ds[known]) <= RIGHT_PX)
            names = tuple(told)
    fit_logits("rivals", names, np.concatenate(evidence), np.concatenate(right)[:, None])


def fit_duel(folders: list[Path]) -> None:
    """The logits of two finalists' being right."""
    evidence, right = [], []
    for contest in contests(folders):
        for at, found, told, ds in contest.taken():
            first, second, score = contest.arena.finalists(found, told)
            met = np.flatnonzero(second >= 0)
            pair = first[met], second[met]
            both = contest.arena.duel(at, found, {**told, "score": score}, met, pair)
            evidence.append(np.concatenate(list(both.values())).T.astype(np.float32))
            right.append(np.stack([np.abs(ds[index, met]) <= RIGHT_PX for index in pair], -1))
            names = tuple(both)
    fit_logits("duel", names, np.concatenate(evidence), np.concatenate(right))


def fit_logits(what: str, names: tuple[str, ...], x: np.ndarray, right: np.ndarray) -> None:
    """Of what is right (n, m), by evidence (n, names)."""
    limits, right = limits_of(x), right.astype(np.float32)
    write(
        what, names, limits, fit(x, limits, of_right(right, np.ones_like(right)), right.shape[1], PLANS[what])
    )


Layers = list[np.ndarray]
"""As the perceptron takes them."""


def of_right(right: np.ndarray, weight: np.ndarray) -> Slopes:
    """Of the cross-entropy: the answers (n, m) become the logits of what share is right."""
    return lambda out, at: (weight[at] * (1 / (1 + np.exp(-out)) - right[at]) / np.float32(len(at))).astype(
        np.float32
    )


def of_size(log_size: np.ndarray, weight: np.ndarray) -> Slopes:
    """Of the absolute deviation: the answer becomes the median of the logarithm, whatever lies far off."""
    return lambda out, at: (
        weight[at, None] * np.clip((out - log_size[at, None]) / ROUND, -1, 1) / np.float32(len(at))
    ).astype(np.float32)


def limits_of(x: np.ndarray) -> np.ndarray:
    """(2, n) beyond which evidence (N, n) is rare, and says no more."""
    mean, spread = np.nanmean(x, axis=0, dtype=float), np.nanstd(x, axis=0, dtype=float)
    low, high = mean - LIMIT * spread, mean + LIMIT * spread
    limits = np.stack([np.maximum(low, np.nanmin(x, axis=0)), np.minimum(high, np.nanmax(x, axis=0))])
    return limits.astype(np.float32)


def fit(
    x: np.ndarray,
    limits: np.ndarray,
    slopes: Slopes,
    outputs: int,
    plan: Plan,
    start: float = 0.0,
) -> Layers:
    """Layers whose answers to evidence within its limits are of least loss."""
    within = np.where(np.isnan(x), limits[0], x)
    np.clip(within, *limits, out=within)
    mean, spread = within.mean(axis=0, dtype=float), within.std(axis=0, dtype=float) + 1e-6
    within -= mean.astype(np.float32)
    within /= spread.astype(np.float32)
    how = Schedule(plan.hidden, plan.epochs, plan.batch, RATE, 1e-6, 0.3)

    def shifted(out: np.ndarray, at: np.ndarray) -> np.ndarray:
        return slopes(out + np.float32(start), at)

    (weights, offset), *others = fitted(within, outputs, shifted, how, np.random.default_rng(0))
    first = np.hstack([weights.T / spread, (offset - (mean / spread) @ weights)[:, None]])
    layers = [first, *(np.hstack([weights.T, offset[:, None]]) for weights, offset in others)]
    layers[-1][:, -1] += start
    return [layer.astype(float) for layer in layers]


def answers(x: np.ndarray, limits: np.ndarray, layers: Layers) -> np.ndarray:
    """(n,) of a network with one."""
    found = np.clip(np.where(np.isnan(x), limits[0], x), *limits)
    for layer in layers[:-1]:
        found = np.maximum(found @ layer[:, :-1].T + layer[:, -1], 0)
    return found @ layers[-1][0, :-1] + layers[-1][0, -1]


def scatter(sample: Sample) -> np.ndarray:
    """(n,) errors in px about their median: sigma tells how they scatter."""
    counted = sample.interior & (np.abs(sample.dz_mm) <= MOST_MM)
    return sample.ds_px - np.median(sample.ds_px[counted]) if counted.any() else sample.ds_px


def fit_pixels(found: list[Sample], what: str) -> None:
    """The logit of a pixel's being right and, but of an impression, the logarithm of its sigma."""
    names = found[0].names
    x = np.concatenate([sample.evidence for sample in found])
    dz = np.abs(np.concatenate([sample.dz_mm for sample in found]))
    limits = limits_of(x)
    unseen = np.concatenate([s.unseen for s in found])
    right = ((dz <= GROSS_MM) & ~unseen).astype(np.float32)
    weight = np.where(unseen, PLANS[what].unseen, 1).astype(np.float32)
    belief = fit(x, limits, of_right(right[:, None], weight[:, None]), 1, PLANS[what])
    if what == "impression":
        write(what, names, limits, belief)
    else:
        write(what, names, limits, beside(belief, sigma_of(found, x, limits, belief)))


def fit_sigma(found: list[Sample]) -> None:
    """Of what ``belief`` tells sigma alone: the logit stays as it is, whatever evidence there is besides."""
    names, kept = found[0].names, load_network("belief")
    x = np.concatenate([sample.evidence for sample in found])
    columns = [names.index(name) for name in kept.names]
    limits = limits_of(x)
    limits[:, columns] = kept.limits
    (units, output), own = kept.layers, PLANS["belief"].hidden[0]
    first = np.zeros((own, len(names) + 1))
    first[:, [*columns, -1]] = units[:own]
    belief = [first, np.hstack([output[:1, :own], output[:1, -1:]]).astype(float)]
    write("belief", names, limits, beside(belief, sigma_of(found, x, limits, belief)))


def sigma_of(found: list[Sample], x: np.ndarray, limits: np.ndarray, belief: Layers) -> Layers:
    """The logarithm of sigma, px: of pixels that are believed and not false."""
    dz, ds = (np.abs(np.concatenate(part)) for part in ([s.dz_mm for s in found], [*map(scatter, found)]))
    known = (dz <= MOST_MM) & (answers(x, limits, belief) > np.log(BELIEVED / (1 - BELIEVED)))
    sizes = np.log(MAD * np.maximum(ds[known], 1e-6)).astype(np.float32)
    weight = np.where(np.concatenate([s.interior for s in found])[known], 1, NEAR).astype(np.float32)
    size = found[0].names.index("size")  # told it, sigma would learn single captures of that size
    units, output = fit(
        np.delete(x[known], size, axis=1), np.delete(limits, size, axis=1), of_size(sizes, weight),
        1, PLANS["sigma"], float(np.median(sizes)),
    )  # fmt: skip
    return [np.insert(units, size, 0, axis=1), output]


def beside(*networks: Layers) -> Layers:
    """Networks with one hidden layer each as one, with all their answers."""
    hidden, outputs = zip(*networks, strict=True)
    constants = np.concatenate([output[:, -1:] for output in outputs])
    output = np.hstack([block_diag(*(output[:, :-1] for output in outputs)), constants])
    return [np.concatenate(hidden), output]


def write(what: str, names: tuple[str, ...], limits: np.ndarray, layers: Layers) -> None:
    """A file of data/, a row a line."""
    parts = {
        "names": table(names),
        "limits": numbers(limits),
        "layers": f"[{', '.join(map(numbers, layers))}]",
    }
    write_text(what, "{" + ",\n".join(f'"{name}": {text}' for name, text in parts.items()) + "}\n")


def write_text(what: str, text: str) -> None:
    """A file of data/."""
    (Path(beltscape.__file__).parent / "data" / f"{what}.json").write_text(text, "utf-8")


def numbers(rows: np.ndarray) -> str:
    """To six digits."""
    return table([[float(f"{value:.6g}") for value in row] for row in rows])


def table(rows: Sequence[object]) -> str:
    """JSON, a row a line."""
    return "[\n" + ",\n".join(map(json.dumps, rows)) + "\n]"


def main() -> None:
    """Match, fit, write."""
    what, folders = sys.argv[1], [Path(folder) for folder in sys.argv[2:]]
    if what in ("rivals", "duel"):
        {"rivals": fit_rivals, "duel": fit_duel}[what](folders)
    elif what == "sigma":
        fit_sigma(list(pixels(folders, "belief")))
    else:
        fit_pixels(list(pixels(folders, what)), what)


if __name__ == "__main__":
    main()
