"""Scrutiny tells doubtful pixels' logits anew, and no others."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import inner, scene
from test_judge import STEP, looked_at_again, stages

from beltscape.kernels import load
from beltscape.stereo.belief import fitted
from beltscape.stereo.judge import closer_look
from beltscape.stereo.scrutiny import DOUBTFUL, Scrutiny, scrutinised


@pytest.fixture(scope="module")
def looked() -> tuple[Scrutiny, np.ndarray, np.ndarray]:
    """What is scrutinised, the logits before, and how far off the surface is: a third of it near steps by much."""
    made = scene(*STEP, noise=1.0)
    rng = np.random.default_rng(4)
    wrong = rng.random(made.s.shape) < 0.1
    match = looked_at_again(stages(made, np.where(wrong, made.s + 6, made.s)))
    assert match.contested is not None
    found, surface = closer_look(match, match.contested, 1.0, load(), 1), match.refined.surface
    (logit, _) = fitted("belief").answers(found.planes, load(), 1)
    return (
        Scrutiny.of(found.planes, surface, made.prepared.core, 1.0, load()),
        logit,
        np.abs(surface.s - made.s),
    )


def test_it_asks_for_what_it_is_shown(looked):
    scrutiny, logit, _ = looked
    shown = scrutiny.look(np.nonzero(logit < DOUBTFUL))
    assert set(fitted("scrutiny").names) == set(shown)
    for name, values in shown.items():
        assert np.isfinite(values).all(), name


def test_only_doubtful_pixels_are_told_anew(looked):
    scrutiny, logit, _ = looked
    found = scrutinised(logit, scrutiny, 1)
    doubtful = logit < DOUBTFUL
    assert doubtful.any()
    assert (~doubtful).any()
    assert found[~doubtful].tobytes() == logit[~doubtful].tobytes()
    assert (found[doubtful] != logit[doubtful]).mean() > 0.99


def test_right_ones_are_believed_more_than_wrong_ones(looked):
    scrutiny, logit, off = looked
    found = scrutinised(logit, scrutiny, 1)
    doubtful = (logit < DOUBTFUL) & inner(logit.shape, 6)
    right, wrong = found[doubtful & (off < 0.5)], found[doubtful & (off > 3)]
    assert len(wrong) > 20
    assert np.median(right) > np.median(wrong) + 2


@pytest.mark.parametrize("threads", [2, 3])
def test_any_number_of_threads_gives_the_same_bytes(looked, threads):
    scrutiny, logit, _ = looked
    assert scrutinised(logit, scrutiny, threads).tobytes() == scrutinised(logit, scrutiny, 1).tobytes()


def test_nobody_doubtful_is_nobody_asked(looked):
    scrutiny, logit, _ = looked
    sure = np.full_like(logit, DOUBTFUL + 1)
    assert scrutinised(sure, scrutiny, 1).tobytes() == sure.tobytes()
