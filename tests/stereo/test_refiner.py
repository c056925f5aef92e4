"""Scrutiny tells doubtful pixels anew, and no others: where they belong, whether they are right, and how well."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes import Scene, away_from_steps, inner, scene
from test_estimate import STEP, looked_at_again, stages

import beltscape
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.files.rasters.depth_tiff import read_float_tiff
from beltscape.files.rasters.images import read_image
from beltscape.files.rig_json import read_rig
from beltscape.kernels import load
from beltscape.stereo.multiview.confidence.estimate import refined_features
from beltscape.stereo.multiview.confidence.refiner import (
    MOST_PX,
    TRIED_PX,
    Prediction,
    RefinementInputs,
    mask_uncertain,
    refine_uncertain_pixels,
)
from beltscape.stereo.multiview.frame.frame import grid_unit
from beltscape.stereo.multiview.frame.windows import windows_for
from beltscape.stereo.multiview.networks import load_network
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.multiview.settings import MultiviewSettings


def looked_at(made: Scene, s: np.ndarray) -> tuple[RefinementInputs, Prediction]:
    """What a surface is scrutinised by, and what is thought of it before."""
    match = looked_at_again(stages(made, s))
    assert match.contested is not None
    found, scrutiny = refined_features(match, match.contested, 1.0, load(), 1)
    return scrutiny, Prediction(
        match.refined.surface.s, *load_network("belief").answers(found.planes, load(), 1)
    )


@pytest.fixture(scope="module")
def looked() -> tuple[RefinementInputs, Prediction, np.ndarray]:
    """A step, a tenth of it wrong by much before; and the truth."""
    made = scene(*STEP, noise=1.0)
    rng = np.random.default_rng(4)
    wrong = rng.random(made.s.shape) < 0.1
    return *looked_at(made, np.where(wrong, made.s + 6, made.s)), made.s


def test_it_asks_for_what_it_is_shown(looked):
    scrutiny, thought, _ = looked
    at = np.nonzero(mask_uncertain(thought.logit))
    shown = scrutiny.look(at, thought.logit[at])
    assert set(load_network("scrutiny").names) == set(shown)
    for name, values in shown.items():
        assert np.isfinite(values).all(), name


def test_only_doubtful_pixels_are_told_anew(looked):
    scrutiny, thought, _ = looked
    found = refine_uncertain_pixels(thought, scrutiny, 1)
    asked = mask_uncertain(thought.logit)
    assert asked.any()
    assert (thought.logit[~asked] < 0).any()
    assert (thought.logit[~asked] > 0).any()
    for new, old in zip(found, thought, strict=True):
        assert new[~asked].tobytes() == old[~asked].tobytes()
        assert (new[asked] != old[asked]).mean() > 0.99
    assert np.abs(found.s - thought.s).max() <= MOST_PX + 1e-3


def test_right_ones_are_believed_more_than_wrong_ones(looked):
    scrutiny, thought, true = looked
    found = refine_uncertain_pixels(thought, scrutiny, 1)
    asked = mask_uncertain(thought.logit) & inner(true.shape, 6)
    off = np.abs(found.s - true)
    right, wrong = found.logit[asked & (off < 0.5)], found.logit[asked & (off > 3)]
    assert len(wrong) > 20
    assert np.median(right) > np.median(wrong) + 2


def test_what_planes_cut_is_put_back():
    data = Path(beltscape.__file__).parent / "data" / "demo"
    rig, true_mm = (
        read_rig(data / "truth" / "rig.json"),
        read_float_tiff(data / "truth" / "belt_loaded_depth.tiff"),
    )
    images = {name: read_image(data / "belt_loaded" / name / "000.png") for name in rig.cameras}
    matcher = MultiviewReconstructor(rig, (520, 800), MultiviewSettings())
    match = matcher.match(FrameSet("000", images), rig.auxiliaries, Silent())
    assert match.contested is not None
    found, scrutiny = refined_features(match, match.contested, windows_for(true_mm.shape[1]).scale, load(), 0)
    thought = Prediction(match.refined.surface.s, *load_network("belief").answers(found.planes, load(), 0))
    s = refine_uncertain_pixels(thought, scrutiny, 0).s
    true = 1 / (true_mm * grid_unit(rig, rig.auxiliaries, 1))
    asked = mask_uncertain(thought.logit) & (thought.logit > 0) & np.isfinite(true)
    before, after = (np.abs(x - true)[asked] for x in (thought.s, s))
    assert asked.sum() > 5000
    for least, gain in ((0.1, 0.005), (0.3, 0.01), (0.7, 0.005)):
        assert (after < least).mean() > (before < least).mean() + gain, least


def test_images_are_less_alike_where_a_surface_is_not(looked):
    scrutiny, _, true = looked
    right = (np.abs(scrutiny.surface.s - true) < 0.1) & away_from_steps(true, 4) & inner(true.shape, 8)
    at = np.nonzero(right)
    shown = scrutiny.look(at, np.zeros(len(at[0]), np.float32))
    for name in ("point mean", "cross mean"):
        here = np.median(scrutiny.planes[name][at])
        off = [np.median(shown[f"{name} {px:+g}"]) for px in TRIED_PX]
        assert off[0] > off[2] > here < off[3] < off[5]


@pytest.mark.parametrize("threads", [2, 3])
def test_any_number_of_threads_gives_the_same_bytes(looked, threads):
    scrutiny, thought, _ = looked
    for many, one in zip(
        refine_uncertain_pixels(thought, scrutiny, threads),
        refine_uncertain_pixels(thought, scrutiny, 1),
        strict=True,
    ):
        assert many.tobytes() == one.tobytes()


def test_nobody_doubtful_is_nobody_asked(looked):
    scrutiny, thought, _ = looked
    sure = thought._replace(logit=np.full_like(thought.logit, 9.0))
    for new, old in zip(refine_uncertain_pixels(sure, scrutiny, 1), sure, strict=True):
        assert new.tobytes() == old.tobytes()
