"""The probability that a cell lies on a lump's outline, and on a lump, by a small network."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.learned.network import Network, compute_probability
from beltscape.learned.registry import load_network
from beltscape.measure.lumps.features import compute_features
from beltscape.measure.lumps.raster import Raster


def predict_outlines(raster: Raster, network: Network | None = None) -> NDArray[np.float32]:
    """Return probabilities (R, C, 2) float32 of an outline, and of a lump (against fines, belt and floor)."""
    network = network or load_network("lumps")
    logits = network.evaluate(compute_features(raster.height_px, raster.measured))
    return compute_probability(np.stack(logits, axis=-1))
