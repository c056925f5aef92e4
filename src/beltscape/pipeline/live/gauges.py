"""What alarms are judged by, gathered from the threads that know it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic

from beltscape.alarms.readings import Readings
from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.core.depth import DepthMap
from beltscape.core.live import CameraHealth

_NAN = float("nan")
_MINUTE_S = 60.0
_STALE_S = 5.0
"""What was measured longer ago says nothing of now."""


@dataclass(slots=True)
class Gauges:
    """The last that was heard of each; every field is set by one thread and read by another."""

    full_area_mm2: float
    entry: BeltRecord | None = None
    """The last with a strip."""
    belt_mm: float = _NAN
    speed_mm_s: float = _NAN
    coverage: float = _NAN
    measured_s: float = float("-inf")
    """Monotonic clock at the last frame that gave depth."""
    heard_s: float = float("-inf")
    """Monotonic clock at the last frame of any kind."""
    depth: DepthMap | None = None
    """Of the last frame; taken away once looked at."""
    lump_mm: tuple[float, float] = (_NAN, _NAN)
    """Largest lump and its σ, until told to the board."""
    offset_mm: tuple[float, float] = (_NAN, _NAN)
    """How far the belt runs off and its σ."""
    encoder_ratio: tuple[float, float] = (_NAN, _NAN)
    dropped: deque[tuple[float, int]] = field(default_factory=deque)
    """(monotonic clock, frame sets dropped so far)."""
    lock: threading.Lock = field(default_factory=threading.Lock)

    def add(self, entries: Sequence[BeltRecord]) -> None:
        """Further entries of the ledger."""
        for entry in entries:
            self.belt_mm = entry.belt_mm[1]
            if entry.strip is not None and entry.standing != "missing":
                self.entry = entry

    def saw(self, depth: DepthMap | None, speed_mm_s: float) -> None:
        """A further frame went through."""
        self.heard_s = monotonic()
        self.measured_s = self.heard_s if depth is not None else self.measured_s
        self.speed_mm_s, self.depth = speed_mm_s, depth
        self.coverage = 0.0 if depth is None else depth.coverage

    def drops(self, so_far: int) -> float:
        """Frame sets dropped in the last minute."""
        now = monotonic()
        self.dropped.append((now, so_far))
        while len(self.dropped) > 1 and now - self.dropped[1][0] > _MINUTE_S:
            self.dropped.popleft()
        return float(so_far - self.dropped[0][1])

    def readings(
        self,
        *,
        cameras: Mapping[str, CameraHealth],
        dropped: int,
        history_trouble: str,
        recording_trouble: str,
        encoder: tuple[float, str] | None,
        certificate_days: float,
    ) -> Readings:
        """As things stand; what is measured now and then is told once.

        ``encoder``: seconds since its last reading, and what is wrong with it; None where there is none.
        """
        with self.lock:
            lump, self.lump_mm = self.lump_mm, (_NAN, _NAN)
            offset, self.offset_mm = self.offset_mm, (_NAN, _NAN)
        now = monotonic()
        area, area_sigma, density = self._load() if now - self.measured_s < _STALE_S else (_NAN, _NAN, _NAN)
        heard = now - self.heard_s < _STALE_S
        speed = self.speed_mm_s if heard else _NAN
        per_hour = speed * 3600e-9
        return Readings(
            area_mm2=area,
            area_sigma_mm2=area_sigma,
            full_area_mm2=self.full_area_mm2,
            volume_flow_m3_h=area * per_hour,
            volume_flow_sigma_m3_h=area_sigma * per_hour,
            mass_flow_t_h=area * per_hour * density * 1e-3,
            mass_flow_sigma_t_h=area_sigma * per_hour * density * 1e-3,
            belt_mm=self.belt_mm,
            speed_mm_s=speed,
            coverage=self.coverage if heard else _NAN,
            largest_lump_mm=lump[0],
            largest_lump_sigma_mm=lump[1],
            belt_offset_mm=offset[0],
            belt_offset_sigma_mm=offset[1],
            cameras=cameras,
            dropped_per_minute=self.drops(dropped),
            history_trouble=history_trouble,
            recording_trouble=recording_trouble,
            encoder_silent_s=_NAN if encoder is None else encoder[0],
            encoder_trouble=None if encoder is None else encoder[1],
            encoder_ratio=self.encoder_ratio[0],
            encoder_ratio_sigma=self.encoder_ratio[1],
            certificate_days=certificate_days,
        )

    def _load(self) -> tuple[float, float, float]:
        """Cross-section, its σ, bulk density; of the last strip that was measured."""
        strip = None if self.entry is None else self.entry.strip
        if strip is None:
            return _NAN, _NAN, _NAN
        length = strip.strip_mm[1] - strip.strip_mm[0]
        sigma = strip.sigma_mm3 / length if length > 0 else _NAN
        return strip.area_mm2, sigma, strip.density_kg_m3
