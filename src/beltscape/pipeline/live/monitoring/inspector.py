"""Periodic inspection of the measured surface for large lumps and belt misalignment."""

from __future__ import annotations

from time import monotonic

from beltscape.core.belt.empty_belt import Belt
from beltscape.core.errors import MeasureError
from beltscape.core.geometry.camera import Camera
from beltscape.measure.flow.periodic_checks import measure_belt_offset, measure_largest_lump
from beltscape.measure.lumps.settings import LumpSettings
from beltscape.pipeline.live.monitoring.gauges import Gauges

_NAN = float("nan")
_LUMPS = LumpSettings(raster_pixels=100_000)
"""Coarser than `measure lumps`: sizes differ by a percent or two, at a third of the cost."""


class PeriodicInspector:
    """Inspects the newest depth map; each inspection has its own period."""

    def __init__(self, belt: Belt, camera: Camera, lumps_every_s: float, edges_every_s: float) -> None:
        """``camera`` is the core camera; a period of 0 s switches the inspection off."""
        self._belt, self._camera = belt, camera
        self._period_s = {"lumps": lumps_every_s, "edges": edges_every_s}
        self._last = dict.fromkeys(self._period_s, float("-inf"))

    def inspect(self, gauges: Gauges) -> None:
        """Make the inspections that are due, if there is a new depth map."""
        now = monotonic()
        due = [name for name, period in self._period_s.items() if period and now - self._last[name] >= period]
        depth = gauges.depth
        if not due or depth is None:
            return
        gauges.depth = None
        for name in due:
            self._last[name] = monotonic()
            try:
                if name == "lumps":
                    value = measure_largest_lump(depth, self._camera, self._belt, _LUMPS)
                else:
                    value = measure_belt_offset(depth, self._camera, self._belt)
            except MeasureError:
                value = (_NAN, _NAN)
            with gauges.lock:
                if name == "lumps":
                    gauges.lump_mm, gauges.last_lump_mm = value, value[0]
                else:
                    gauges.offset_mm = value
