"""The running system as a protocol sees it: its present state, and the records of the ledger."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from beltscape.core.alarms import Alarm
from beltscape.core.belt.ledger_entries import BeltRecord, Standing, Totals
from beltscape.core.live import CameraHealth


@dataclass(frozen=True, slots=True)
class PlantState:
    """The present state of one belt; NaN: not known."""

    wall_ns: int
    """System clock, ns since 1970."""
    standing: Standing
    """Worst standing of the records behind the flow."""
    volume_flow_m3_h: float
    volume_flow_sigma_m3_h: float
    """One standard deviation."""
    mass_flow_t_h: float
    """NaN without a density."""
    mass_flow_sigma_t_h: float
    """One standard deviation, from the volume alone."""
    area_mm2: float
    """Mean cross-section of the load."""
    coverage: float
    """Share of the load that was measured, 0..1."""
    speed_m_s: float
    """Speed of the belt."""
    record: int
    """Number of the newest record; 0 while there is none."""
    totals: Totals
    cameras: tuple[CameraHealth, ...]
    alarms: tuple[Alarm, ...]
    maintenance: str
    """Reason of the present maintenance; empty: there is none."""
    product: str
    """Name of the present product; empty: none."""
    batch: str
    """Name of the present batch; empty: there is none."""


class Plant(Protocol):
    """The running system; every method may be called from any thread and returns at once."""

    def read_state(self) -> PlantState:
        """Return the present state."""
        ...

    def read_records(self, after: int, limit: int) -> Sequence[BeltRecord]:
        """Return at most ``limit`` stored records with numbers above ``after``, in the ledger's order."""
        ...

    def read_last_number(self) -> int:
        """Return the number of the newest stored record; 0 while there is none."""
        ...


class PlantCommands(Protocol):
    """What a protocol may change, once it has checked the user's role; every method may be called from any thread.

    Each raises InputError with one line where it is refused.
    """

    def acknowledge(self, alarm: str, user: str) -> None:
        """Acknowledge the alarm of that name."""
        ...

    def start_batch(self, name: str, product: str, user: str) -> None:
        """Start a batch; ``product`` empty: the present product."""
        ...

    def stop_batch(self, user: str) -> None:
        """Stop the present batch."""
        ...

    def change_product(self, name: str, user: str) -> None:
        """Make a product the present one."""
        ...
