"""The flow on a moving belt: depth maps in, flow records out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from beltscape.api.measuring import require_belt_of
from beltscape.core.arguments import require_depth_of
from beltscape.core.checks import require_choice, require_instance, require_number, show_value
from beltscape.core.depth import DepthMap
from beltscape.core.display import Displayed
from beltscape.core.empty_belt import Belt
from beltscape.core.errors import InputError
from beltscape.core.geometry.rig import Rig
from beltscape.core.ledger import FlowRecord
from beltscape.measure.belt.reference import make_reference
from beltscape.measure.flow import meter
from beltscape.measure.flow.density import Density
from beltscape.measure.flow.settings import Direction, FlowSettings
from beltscape.measure.flow.strips import FlowTotals
from beltscape.pipeline.measuring.flow_checks import require_consistent_motion

_ENCODER = Path("position_mm")
"""How errors name the encoder: by the argument of `FlowMeter.push`."""
_LITRES_MM3 = 1e-6
"""Litres of a mm³."""


class FlowMeter(Displayed):
    """Measures what passes on a moving belt.

    >>> meter = bs.FlowMeter(rig, belt, density_kg_m3=1600)
    >>> records = meter.push(depth, time_ns=0, position_mm=0.0)
    >>> records += meter.finish()

    Push the depth map of every frame, in order, then call `finish`. A record is returned some frames after its frame
    was pushed: when its strip of belt has left the view.
    """

    def __init__(
        self,
        rig: Rig,
        belt: Belt,
        direction: Direction | None = None,
        *,
        density_kg_m3: float | None = None,
        settings: FlowSettings | None = None,
    ) -> None:
        """Prepare the meter.

        Parameters
        ----------
        rig
            The calibrated rig.
        belt
            The empty belt, learned with this rig.
        direction
            "+y" or "-y", the direction of travel in the belt frame; None: it is found from the material.
        density_kg_m3
            Bulk density; None: records have no mass.
        settings
            Further settings; ``direction`` is put into them.

        Raises
        ------
        InputError, MeasureError
            with the argument that does not fit, or if the belt is nowhere visible across its width.
        """
        require_belt_of(belt, rig)
        require_choice(direction, "direction", ("+y", "-y", None))
        if density_kg_m3 is not None:
            require_number(density_kg_m3, "density_kg_m3", 0.0, above=True)
        if settings is not None:
            require_instance(settings, FlowSettings, "settings", "beltscape.measure.flow.settings")
        settings = (settings or FlowSettings()).model_copy(update={"direction": direction})
        density = None if density_kg_m3 is None else Density.constant(density_kg_m3)
        reference = make_reference(belt, rig.core_camera, settings.cell_mm)
        self._meter = meter.BeltFlowMeter(reference, settings, density=density, scale_sigma=rig.scale_sigma)
        self._rig, self._direction, self._has_encoder = rig, direction, False
        self.records: list[FlowRecord] = []
        """All records returned so far."""

    @property
    def totals(self) -> FlowTotals:
        """The totals over all records returned so far."""
        return self._meter.totals

    def push(
        self, depth: DepthMap | None, time_ns: int | None = None, position_mm: float | None = None
    ) -> list[FlowRecord]:
        """Add the next frame and return the records that it completes.

        Parameters
        ----------
        depth
            The frame's depth map; None for an instant without one: its belt is bridged or missing.
        time_ns
            Trigger time; None without times, then for all frames.
        position_mm
            The encoder's reading, growing with the travel; None without an encoder: the material's motion counts.

        Raises
        ------
        InputError
            if the depth map is not the rig's.
        MeasureError
            if the material contradicts the given direction or the encoder.
        """
        if depth is not None:
            require_depth_of(self._rig.core_camera, depth, "frame")
        if time_ns is not None and not isinstance(time_ns, int | np.integer):
            raise InputError(f"time_ns = {show_value(time_ns)}: must be whole nanoseconds, or None")
        if position_mm is not None:
            require_number(position_mm, "position_mm")
        self._has_encoder |= position_mm is not None
        return self._keep(self._meter.push(depth, time_ns, position_mm), done=False)

    def finish(self) -> list[FlowRecord]:
        """Return the remaining records after the last frame.

        Raises
        ------
        MeasureError
            if the material contradicts the given direction or the encoder.
        """
        return self._keep(self._meter.finish(), done=True)

    def _keep(self, records: list[FlowRecord], *, done: bool) -> list[FlowRecord]:
        encoder = _ENCODER if self._has_encoder else None
        require_consistent_motion(self._meter, self._direction, encoder, done=done)
        self.records += records
        return records

    def plot(self) -> Any:
        """Return a Matplotlib figure of the records returned so far."""
        from beltscape.report.notebook import plot_records  # loads Matplotlib

        return plot_records(self.records)

    def __repr__(self) -> str:
        totals = self.totals
        volume, sigma = totals.volume_mm3 * _LITRES_MM3, totals.sigma_mm3 * _LITRES_MM3
        return f"FlowMeter({totals.length_mm / 1000:.2f} m, {volume:.2f} ± {sigma:.2f} l)"
