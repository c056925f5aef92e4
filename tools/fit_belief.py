"""Fit the weights of confidence and sigma (stereo/judge.py) to simulated captures with truth.

    python tools/fit_belief.py CAPTURE…

Each CAPTURE is what ``beltscape simulate SCENE --out CAPTURE`` wrote: loaded belts, modules and empty belts, with and
without speckle, of several rigs and seeds. Every capture is matched with all its auxiliaries, with two and with one,
by the presets standard and fast. Prints both tables; judge on captures that are not among them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.files.images import read_image
from beltscape.files.rig_json import read_rig
from beltscape.kernels import load
from beltscape.stereo import judge
from beltscape.stereo.multiview import MultiviewReconstructor
from beltscape.stereo.multiview_settings import MultiviewSettings
from beltscape.stereo.prepared import grid_unit
from beltscape.stereo.search import find_depth_range
from beltscape.stereo.sight import seen_by
from beltscape.stereo.windows import windows

GROSS_MM = 5.0
ALONG_MM = 240.0
"""The projector lights little more of the belt."""
ON_FAILURE_MM = (560.0, 800.0)
"""Depth range of captures that show nothing, which are to be learnt from as well."""
SAMPLES = 50_000
SIGMA_OF = ("constant", "log sigma", "bend", "wide bend", "cost around", "near a step", "steepness")


@dataclass(frozen=True)
class Sample:
    """Evidence and errors of a match's pixels."""

    names: list[str]
    evidence: np.ndarray
    dz_mm: np.ndarray
    ds_px: np.ndarray


def samples(folder: Path) -> Iterator[Sample]:
    """A capture's matches."""
    rig = read_rig(folder / "truth" / "rig.json")
    truth = np.load(next((folder / "truth").glob("*_depth.npz")))
    images = {name: read_image(next((folder / name).glob("000.*"))) for name in rig.cameras}
    for names in (rig.auxiliaries, rig.auxiliaries[:3:2], rig.auxiliaries[:1]):
        frame = FrameSet("000", {name: images[name] for name in (rig.core, *names)})
        try:
            near_far = find_depth_range(rig, frame, Silent())
        except ReconstructionError:
            near_far = ON_FAILURE_MM
        for preset in ("standard", "fast"):
            yield _sample(rig, frame, names, near_far, MultiviewSettings.preset(preset), truth)


def _sample(rig, frame, names, near_far, settings, truth) -> Sample:
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
    scale = windows(width).scale
    listed = list(judge.evidence(match.chosen, match.refined, match.prepared, seen, scale))
    unit = grid_unit(rig, names, step)
    chosen = np.flatnonzero(use)
    chosen = np.random.default_rng(0).permutation(chosen)[:SAMPLES]
    found, true = s.ravel()[chosen].astype(float), true_mm.ravel()[chosen].astype(float)
    return Sample(
        [name for name, _ in listed],
        np.stack([np.nan_to_num(value).ravel()[chosen] for _, value in listed], axis=-1).astype(float),
        1 / (found * unit) - true,
        found - 1 / (true * unit),
    )


def confidence_weights(x: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Logistic regression with a slight ridge, on standardised evidence."""
    mean, spread = x.mean(axis=0), x.std(axis=0) + 1e-9
    mean[0], spread[0] = 0, 1
    z = (x - mean) / spread

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        t = z @ w
        value = (np.logaddexp(0, -t) * right + np.logaddexp(0, t) * (1 - right)).mean()
        return value + 1e-4 * (w @ w), z.T @ (1 / (1 + np.exp(-t)) - right) / len(right) + 2e-4 * w

    w = minimize(loss, np.zeros(x.shape[1]), jac=True, method="L-BFGS-B").x / spread
    w[0] -= w[1:] @ mean[1:]
    return w


def sigma_weights(x: np.ndarray, size_px: np.ndarray) -> np.ndarray:
    """Median regression of the logarithm of the error, by reweighted least squares; σ is 1.4826 medians."""
    y = np.log(size_px + 1e-4)
    w = np.linalg.lstsq(x, y)[0]
    for _ in range(60):
        weight = 1 / np.maximum(np.abs(y - x @ w), 0.02)
        w = np.linalg.solve((x * weight[:, None]).T @ x, (x * weight[:, None]).T @ y)
    w[0] += np.log(1.4826)
    return w


def main() -> None:
    """Match, fit, print."""
    found = [sample for folder in sys.argv[1:] for sample in samples(Path(folder))]
    names = found[0].names
    x = np.concatenate([sample.evidence for sample in found])
    dz, ds = (np.concatenate([getattr(sample, field) for sample in found]) for field in ("dz_mm", "ds_px"))
    w = confidence_weights(x, (np.abs(dz) <= GROSS_MM).astype(float))
    believed = (x @ w > np.log(4)) & (np.abs(ds) < 2)
    columns = [names.index(name) for name in SIGMA_OF]
    v = sigma_weights(x[believed][:, columns], np.abs(ds[believed]))
    print("WEIGHTS =", {name: round(float(value), 3) for name, value in zip(names, w, strict=True)})
    print("SIGMA_WEIGHTS =", {name: round(float(value), 3) for name, value in zip(SIGMA_OF, v, strict=True)})


if __name__ == "__main__":
    main()
