"""The probability that a cell lies on a lump's outline, and on a lump, by a small network.

Its weights were fitted to simulated heaps (tools/train_lumps.py) and are in data/lumps.json.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.measure.lumps.features import compute_features
from beltscape.measure.lumps.raster import Raster
from beltscape.measure.network import Network, load_network

_ROWS = 64
"""Rows processed at a time, which bounds the memory."""


def predict_outlines(raster: Raster, network: Network | None = None) -> NDArray[np.float32]:
    """Return probabilities (R, C, 2) float32 of an outline, and of a lump (against fines, belt and floor)."""
    network = network or load_network("lumps")
    values = compute_features(raster.height_px, raster.measured)
    rows, columns, number = values.shape
    # strips of rows fit into the processor's cache
    strips = [
        network.predict_probabilities(values[top : top + _ROWS].reshape(-1, number)).reshape(-1, columns, 2)
        for top in range(0, rows, _ROWS)
    ]
    return np.concatenate(strips)
