"""The running system as a protocol sees it: its present state, and the records of the ledger."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from beltscape.core.alarms import Alarm
from beltscape.core.events import CameraHealth
from beltscape.core.findings import Finding
from beltscape.core.ledger import BeltRecord, Standing, Totals

Provenance = Mapping[str, str]
"""What the values come from: key, such as "Program" or "Rig" → its name, version or hash."""
UserRole = Literal["viewer", "operator", "engineer"]
"""The roles of the service's users, from least to most."""


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
    full_area_mm2: float
    """Cross-section of the fully loaded belt."""
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
    largest_lump_mm: float
    """Sieve size of the largest lump at the last search; 0: there was none."""
    findings: tuple[Finding, ...]
    """Newest finding of every check of the system about itself."""
    product: str
    """Name of the present product; empty: none."""
    batch: str
    """Name of the present batch; empty: there is none."""
    products: tuple[str, ...] = ()
    """Names of all products, in the order of the settings."""


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

    def read_period(self, since_ns: int, until_ns: int, limit: int, after: int) -> Sequence[BeltRecord]:
        """Return at most ``limit`` records of a period (its end excluded) with numbers above ``after``, in order."""
        ...


class PlantCommands(Protocol):
    """Commands that a protocol may give once it has checked the user's role; any thread may call any method.

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


class PlantUsers(Protocol):
    """The users of the service and its audit log; every method may be called from any thread."""

    def find_by_password(self, name: str, password: str, address: str) -> str | None:
        """Return the user's stored name; None if name or password is wrong, or the caller must wait."""
        ...

    def has_role(self, user: str, role: UserRole) -> bool:
        """Return whether there is that user, and its present role includes ``role``."""
        ...

    def write_audit(self, action: str, user: str, address: str, detail: Mapping[str, str]) -> None:
        """Add an entry to the audit log."""
        ...
