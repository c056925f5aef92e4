"""Values as currents of 4 to 20 mA, with the limits of NAMUR NE 43."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite

from beltscape.protocols.outputs.settings import AnalogueSettings, Quantity
from beltscape.protocols.plant import PlantState

_LOW_MA, _HIGH_MA = 3.8, 20.5
"""Limits of a measured value; beyond its scale it stays at them (NAMUR NE 43)."""
FAILURE_MA = {"low": 3.5, "high": 21.5}
"""Currents of a failure: at most 3.6 mA or at least 21 mA (NAMUR NE 43)."""
_READ: Mapping[Quantity, Callable[[PlantState], float]] = {
    "flow_t_h": lambda state: state.mass_flow_t_h,
    "flow_m3_h": lambda state: state.volume_flow_m3_h,
    "load_m2": lambda state: state.area_mm2 * 1e-6,
    "coverage": lambda state: state.coverage,
    "speed_m_s": lambda state: state.speed_m_s,
}


def compute_current_ma(settings: AnalogueSettings, state: PlantState) -> float:
    """Return the current of an output; that of a failure where the value is not known or nothing is measured."""
    value = _READ[settings.value](state)
    if not isfinite(value) or (state.standing == "missing" and settings.value != "speed_m_s"):
        return FAILURE_MA[settings.failure]
    share = (value - settings.zero) / (settings.full - settings.zero)
    return min(max(4.0 + 16.0 * share, _LOW_MA), _HIGH_MA)
