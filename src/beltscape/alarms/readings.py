"""What alarms are judged by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from beltscape.core.live import CameraHealth

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Readings:
    """How things stand at one moment; NaN and None: not known, which neither raises nor clears an alarm."""

    area_mm2: float = _NAN
    """Cross-section of the load."""
    area_sigma_mm2: float = _NAN
    """One standard deviation of it; a σ that is not known counts as 0."""
    full_area_mm2: float = _NAN
    """Cross-section of the fully loaded belt (`measure.capacity.full_area_mm2`)."""
    volume_flow_m3_h: float = _NAN
    volume_flow_sigma_m3_h: float = _NAN
    mass_flow_t_h: float = _NAN
    mass_flow_sigma_t_h: float = _NAN
    belt_mm: float = _NAN
    """Where the belt is, as in the ledger: delays in millimetres of belt are counted by it."""
    speed_mm_s: float = _NAN
    coverage: float = _NAN
    """Share of the core's pixels that were measured, 0..1."""
    largest_lump_mm: float = _NAN
    """Sieve size of the largest lump; 0: there is none; NaN: it was not looked for this time."""
    largest_lump_sigma_mm: float = _NAN
    belt_offset_mm: float = _NAN
    """How far the belt runs off to +x; NaN also where its ends cannot be seen."""
    belt_offset_sigma_mm: float = _NAN
    cameras: Mapping[str, CameraHealth] = field(default_factory=dict)
    dropped_per_minute: float = _NAN
    """Frame sets that were left out."""
    history_trouble: str | None = None
    """Why the history cannot be written, and the mend, in one line; empty: it can."""
    recording_trouble: str | None = None
    """Why raw frames are not recorded, and the mend; empty: they are, or need not be."""
    encoder_silent_s: float = _NAN
    """Since the encoder's last reading; NaN where there is none to be heard."""
    encoder_trouble: str | None = None
    """What is wrong with what the encoder says; empty: nothing; None: there is no encoder."""
    encoder_ratio: float = _NAN
    """Encoder's travel over the material's; NaN before they were compared."""
    encoder_ratio_sigma: float = _NAN
    certificate_days: float = _NAN
    """Until the web server's certificate ends; NaN without one."""

    @property
    def fill(self) -> float:
        """Cross-section over that of the fully loaded belt."""
        return self.area_mm2 / self.full_area_mm2 if self.full_area_mm2 > 0 else _NAN

    @property
    def fill_sigma(self) -> float:
        """One standard deviation of it."""
        return self.area_sigma_mm2 / self.full_area_mm2 if self.full_area_mm2 > 0 else _NAN

    @property
    def skew_ms(self) -> float:
        """The largest skew of a camera that is not lost, to either side; NaN where none is known."""
        known = [abs(one.skew_ms) for one in self.cameras.values() if one.state in ("ok", "unusable")]
        known = [value for value in known if np.isfinite(value)]
        return max(known) if known else _NAN
