"""Answers of a belt's machine, as far as the site reads them; fields that other versions add are ignored."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.belt.ledger_entries import Standing

_Number = Annotated[int, Field(ge=0, le=2**53)]
_WallMs = Annotated[int, Field(ge=0, le=4_102_444_800_000)]
"""System clock, ms since 1970, up to the beginning of 2100."""


class _Answer(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class PageAnswer(_Answer):
    """GET /api/page."""

    version: str
    plant: str
    stale_s: float
    full_m3_h: float | None = None


class FlowAnswer(_Answer):
    """Flow of a state; None: not known."""

    volume_m3_h: float | None
    sigma_m3_h: float | None
    mass_t_h: float | None
    mass_sigma_t_h: float | None
    area_m2: float | None
    coverage: float | None
    trend: str
    standing: Standing
    age_s: float | None


class FramesAnswer(_Answer):
    """Frames of a state."""

    speed_m_s: float | None
    age_s: float | None


class TotalsAnswer(_Answer):
    """Totals of the ledger."""

    records: int
    volume_m3: float
    sigma_m3: float | None
    mass_t: float | None
    valid_m: float
    degraded_m: float
    missing_m: float
    since_ms: int | None


class CameraAnswer(_Answer):
    """Health of a camera."""

    name: str
    state: str


class AlarmAnswer(_Answer):
    """An alarm that is not clear."""

    name: str
    severity: str
    state: str
    value: float | None
    limit: float | None
    unit: str
    since_ms: int | None
    detail: str
    cause: str
    values: dict[str, Any]


class MaintenanceAnswer(_Answer):
    """The present maintenance."""

    reason: str
    until_ms: int


class StateAnswer(_Answer):
    """GET /api/state."""

    stale_s: float | None = None
    """None: of a version that has it among the settings of the page only."""
    wall_ms: _WallMs
    frames: FramesAnswer
    flow: FlowAnswer
    totals: TotalsAnswer
    cameras: tuple[CameraAnswer, ...]
    alarms: tuple[AlarmAnswer, ...]
    record: int | None
    maintenance: MaintenanceAnswer | None


class RecordAnswer(_Answer):
    """An entry of the ledger, GET /api/records."""

    number: _Number
    run: _Number
    wall_ms: _WallMs
    from_m: float
    to_m: float
    standing: Standing
    volume_m3: float | None
    sigma_m3: float | None
    mass_t: float | None

    @property
    def length_m(self) -> float:
        """Return the length of belt."""
        return self.to_m - self.from_m

    @property
    def mark(self) -> str:
        """Return what tells this entry from another one of the same number."""
        return f"{self.number}/{self.run}/{self.wall_ms}/{self.from_m:.6f}/{self.to_m:.6f}"
