"""Readings of the running system that the alarms are evaluated on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from beltscape.core.events import NO_CAPACITY, CameraHealth, Capacity, CertificateReading
from beltscape.core.findings import Finding

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Readings:
    """The state of the system at one moment; NaN and None mean unknown, which neither raises nor clears an alarm."""

    area_mm2: float = _NAN
    """Cross-section of the load."""
    area_sigma_mm2: float = _NAN
    """One standard deviation of it; an unknown σ counts as 0."""
    full_area_mm2: float = _NAN
    """Cross-section of the fully loaded belt (`measure.volume.load.compute_capacity_mm2`)."""
    volume_flow_m3_h: float = _NAN
    volume_flow_sigma_m3_h: float = _NAN
    mass_flow_t_h: float = _NAN
    mass_flow_sigma_t_h: float = _NAN
    belt_mm: float = _NAN
    """The belt's position in the ledger; it counts the delays in millimetres of belt."""
    speed_mm_s: float = _NAN
    coverage: float = _NAN
    """Share of the core's pixels that were measured, 0..1."""
    largest_lump_mm: float = _NAN
    """Sieve size of the largest lump; 0: there is none; NaN: not measured this time."""
    largest_lump_sigma_mm: float = _NAN
    belt_offset_mm: float = _NAN
    """Offset of the belt from the middle towards +x; NaN also where its ends are not visible."""
    belt_offset_sigma_mm: float = _NAN
    cameras: Mapping[str, CameraHealth] = field(default_factory=dict[str, CameraHealth])
    core: str | None = None
    """Name of the core camera, without which nothing is measured."""
    dropped_per_minute: float = _NAN
    """Frame sets that were not measured."""
    capacity: Capacity = NO_CAPACITY
    """What the computer can measure."""
    history_trouble: str | None = None
    """Why the history cannot be written, and the fix, in one line; empty: it can."""
    history_repair: str | None = None
    """What was repaired in the history a moment ago; empty: nothing."""
    users_trouble: str | None = None
    """Why nobody can sign in, and the fix, in one line; empty: everybody can."""
    reports_trouble: str | None = None
    """Why reports are not written, mailed or printed, in one line; empty: they are, or need not be."""
    recording_trouble: str | None = None
    """Why raw frames are not recorded, and the fix; empty: they are, or need not be."""
    gpu_trouble: str | None = None
    """Why the GPU is no longer used, in one line; empty: it is, or there is none."""
    encoder_silent_s: float = _NAN
    """Time since the encoder's last reading; NaN without an encoder."""
    encoder_trouble: str | None = None
    """The fault of the encoder's readings; empty: none; None: there is no encoder."""
    findings: Sequence[Finding] = ()
    """The latest finding of every check and camera."""
    certificate_days: float = _NAN
    """Days until the web server's certificate ends; NaN without one."""
    test_certificate: CertificateReading | None = None
    """The certificate of the material test; None: there is none."""
    is_maintained: bool = False
    """Whether people work at the system: alarms of measurement are neither raised nor cleared."""

    @property
    def fill(self) -> float:
        """Ratio of the cross-section to that of the fully loaded belt."""
        return self.area_mm2 / self.full_area_mm2 if self.full_area_mm2 > 0 else _NAN

    @property
    def fill_sigma(self) -> float:
        """One standard deviation of it."""
        return self.area_sigma_mm2 / self.full_area_mm2 if self.full_area_mm2 > 0 else _NAN

    @property
    def skew_ms(self) -> float:
        """The largest skew of a camera that is not lost, to either side; NaN where none is known."""
        skews_ms = [
            abs(camera.skew_ms) for camera in self.cameras.values() if camera.state in ("ok", "unusable")
        ]
        skews_ms = [value for value in skews_ms if np.isfinite(value)]
        return max(skews_ms) if skews_ms else _NAN
