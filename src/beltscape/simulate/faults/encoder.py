"""Faults of the encoder: functions from true to faulty readings."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from beltscape.simulate.faults.base import Fault, Seed

EncoderKind = Literal["reversed", "frozen", "lifted", "jumping", "wild", "slip", "scale", "reset", "silent"]
_DEFAULT_SIZE = {"jumping": 500.0, "wild": 100.0, "slip": 0.03, "scale": 1.1}
"""Size of the faults that have one, where none is given."""


class EncoderFault(Fault):
    """A fault of the encoder.

    ========  ===================================================================================
    kind      effect on the readings from ``first`` to ``last``
    ========  ===================================================================================
    reversed  they count backwards
    frozen    they stand still; afterwards they jump to the true position
    lifted    they stand still; the travel is lost
    jumping   they jump once by ``size`` mm
    wild      every reading is off by random numbers of a standard deviation of ``size`` mm
    slip      they lose the share ``size`` of the travel
    scale     they count ``size`` times the travel
    reset     they begin again at 0
    silent    there are none
    ========  ===================================================================================
    """

    kind: EncoderKind
    size: Annotated[float, Field(ge=-1e6, le=1e6)] | None = None
    """See the table; None: jumping 500 mm, wild 100 mm, slip 0.03, scale 1.1."""
    last: Annotated[int, Field(ge=0, le=100_000)] | None = None
    """The last frame with the fault; None: it remains."""
    seed: Seed = 1

    def apply(self, position_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the readings (N,) of frames with these true positions (N,), mm; NaN: no reading."""
        position = np.asarray(position_mm, float)
        index = np.arange(len(position))
        active = (index >= self.first) & (index <= (len(position) if self.last is None else self.last))
        size = _DEFAULT_SIZE.get(self.kind, 0.0) if self.size is None else self.size
        factor = {"reversed": -1.0, "lifted": 0.0, "slip": 1 - size, "scale": size}.get(self.kind)
        if factor is not None:
            return _scale_travel(position, active, factor)
        held = position[max(self.first - 1, 0)] if len(position) else 0.0
        if self.kind == "frozen":
            return np.where(active, held, position)
        if self.kind == "jumping":
            return position + np.where(index >= self.first, size, 0.0)
        if self.kind == "wild":
            noise = np.random.default_rng(self.seed).normal(size=len(position))
            return position + np.where(active, size * noise, 0.0)
        if self.kind == "reset":
            return position - np.where(index >= self.first, held, 0.0)
        return np.where(active, np.nan, position)


def _scale_travel(
    position_mm: NDArray[np.float64], active: NDArray[np.bool_], factor: float
) -> NDArray[np.float64]:
    """Return positions whose steps into the active frames are scaled."""
    steps = np.diff(position_mm, prepend=position_mm[:1])
    scaled = np.where(active, factor * steps, steps)
    scaled[:1] = 0.0
    return position_mm[:1] + np.cumsum(scaled)
