"""What is looked for now and then in the measured surface: large lumps, a belt that runs off."""

from __future__ import annotations

from time import monotonic

from beltscape.core.belt.empty_belt import Belt
from beltscape.core.camera import Camera
from beltscape.core.errors import MeasureError
from beltscape.measure.flow.periodic_checks import belt_offset, largest_lump
from beltscape.measure.lumps.settings import LumpSettings
from beltscape.pipeline.live.gauges import Gauges

_NAN = float("nan")
_LUMPS = LumpSettings(raster_pixels=100_000)
"""A coarser look than `measure lumps`: sizes differ by a percent or two, for a third of the work."""


class Looker:
    """Looks at the newest depth map, each thing at its own pace."""

    def __init__(self, belt: Belt, camera: Camera, lumps_every_s: float, edges_every_s: float) -> None:
        """``camera`` is the one whose depth is measured; 0 s: never."""
        self._belt, self._camera = belt, camera
        self._every = {"lumps": lumps_every_s, "edges": edges_every_s}
        self._last = dict.fromkeys(self._every, float("-inf"))

    def look(self, gauges: Gauges) -> None:
        """Look where it is time, and there is something new to look at."""
        due = [
            name for name, every in self._every.items() if every and monotonic() - self._last[name] >= every
        ]
        depth = gauges.depth
        if not due or depth is None:
            return
        gauges.depth = None
        for name in due:
            self._last[name] = monotonic()
            try:
                if name == "lumps":
                    found = largest_lump(depth, self._camera, self._belt, _LUMPS)
                else:
                    found = belt_offset(depth, self._camera, self._belt)
            except MeasureError:
                found = (_NAN, _NAN)
            with gauges.lock:
                if name == "lumps":
                    gauges.lump_mm = found
                else:
                    gauges.offset_mm = found
