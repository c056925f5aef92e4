"""The fitted network that turns a pixel's evidence into confidence and sigma."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """A perceptron's weights, in its evidence's own units."""

    names: tuple[str, ...]
    """Of the evidence, in order."""
    limits: Array
    """(2, n) beyond which evidence says no more."""
    hidden: Array
    """(k, n + 1)."""
    output: Array
    """(2, k + 1), to the logit of the confidence and the logarithm of sigma in px of s."""


@cache
def fitted() -> Belief:
    """The weights that ship: what tools/fit_belief.py made of simulated frames with known truth."""
    kept = json.loads((files("beltscape") / "data" / "belief.json").read_text(encoding="utf-8"))
    return Belief(tuple(kept["names"]), *(_array(kept[part]) for part in ("limits", "hidden", "output")))


def _array(rows: Sequence[Sequence[float]]) -> Array:
    return np.array(rows, np.float32)
