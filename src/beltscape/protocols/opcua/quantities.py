"""The quantities that are served: node, unit, value in the present state and in a record, and their status."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from asyncua import ua

from beltscape.core.ledger import BeltRecord, FlowRecord, Standing
from beltscape.protocols.opcua.address_space import CONVEYING, MEASURED_ITEM_TYPE, OWN, SCALES
from beltscape.protocols.plant import PlantState

Read = Callable[[PlantState], float]
ReadRecord = Callable[[BeltRecord], float]
_ANALOGUE = ua.NodeId(ua.ObjectIds.AnalogUnitType)
_STATUS: dict[Standing, int] = {
    "valid": ua.StatusCodes.Good,
    "degraded": ua.StatusCodes.UncertainSensorNotAccurate,
    "missing": ua.StatusCodes.BadSensorFailure,
}
"""Status of the ledger's quality: measured well, measured with less certainty, not measured."""


@dataclass(frozen=True, slots=True)
class OpcUaQuantity:
    """One number with a unit."""

    path: str
    """Names from the belt to the node, separated by dots."""
    unit: str
    text: str
    """What it is, in one line."""
    read: Read
    basis: Literal["flow", "speed", "total"] = "flow"
    """Its status: that of the flow's quality; good where it is known; good, as the ledger counts what is missing."""
    record: ReadRecord | None = None
    """Its value in a record; None: it has no history."""
    absent: int = ua.StatusCodes.BadSensorFailure
    """Status where the value is not known although the belt is measured."""
    namespace: int = OWN
    """Of its name."""
    kind: ua.NodeId = _ANALOGUE

    @property
    def is_weight(self) -> bool:
        """Return whether OPC 40200 states it as a structure of gross, net and tare."""
        return self.namespace == SCALES and self.unit == "t"

    @property
    def name(self) -> ua.QualifiedName:
        """Return its browse name."""
        return ua.QualifiedName(self.path.rpartition(".")[2], self.namespace)

    def find_status(self, state: PlantState, value: float) -> int:
        """Return the status of its present value."""
        if self.basis == "flow" and state.maintenance:
            return ua.StatusCodes.BadOutOfService
        if self.basis == "flow" and state.standing == "missing":
            return ua.StatusCodes.BadSensorFailure
        if not math.isfinite(value):
            return self.absent
        return _STATUS[state.standing] if self.basis == "flow" else ua.StatusCodes.Good

    def find_record_status(self, record: BeltRecord, value: float) -> int:
        """Return the status of its value in a record."""
        if record.standing != "missing" and not math.isfinite(value):
            return self.absent
        return _STATUS[record.standing]


def _read_strip(read: Callable[[FlowRecord], float]) -> ReadRecord:
    return lambda record: math.nan if record.strip is None else read(record.strip)


_MASS_FLOW = _read_strip(lambda strip: strip.mass_flow_t_h)
_SPEED = _read_strip(lambda strip: strip.speed_mm_s * 1e-3)
_NO_DENSITY = ua.StatusCodes.BadConfigurationError
"""A mass without a density: the settings lack it."""


def _compute_load(state: PlantState) -> float:
    """Return the mass per length of belt, kg/m, from the cross-section and the density behind the flows."""
    if state.area_mm2 == 0.0:
        return 0.0 if math.isfinite(state.mass_flow_t_h) else math.nan
    if not state.volume_flow_m3_h:
        return math.nan
    return state.area_mm2 * 1e-6 * 1000 * state.mass_flow_t_h / state.volume_flow_m3_h


_PROCESS = "Belt.Monitoring.Process"
_SCALE_PROCESS = "Belt.Components.BeltScale.Monitoring.Process"
_SCALE = "Belt.Components.Scale"
QUANTITIES: tuple[OpcUaQuantity, ...] = (
    OpcUaQuantity(
        f"{_PROCESS}.VolumeFlowRate", "m³/h", "volume flow", lambda s: s.volume_flow_m3_h,
        record=_read_strip(lambda strip: strip.volume_flow_m3_h),
    ),
    OpcUaQuantity(
        f"{_PROCESS}.VolumeFlowRateSigma", "m³/h", "one standard deviation of the volume flow",
        lambda s: s.volume_flow_sigma_m3_h,
    ),
    OpcUaQuantity(
        f"{_PROCESS}.MassFlowRate", "t/h", "mass flow", lambda s: s.mass_flow_t_h, record=_MASS_FLOW,
        absent=_NO_DENSITY,
    ),
    OpcUaQuantity(
        f"{_PROCESS}.MassFlowRateSigma", "t/h", "one standard deviation of the mass flow, from the volume alone",
        lambda s: s.mass_flow_sigma_t_h, absent=_NO_DENSITY,
    ),
    OpcUaQuantity(
        f"{_PROCESS}.BeltSpeed", "m/s", "speed of the belt", lambda s: s.speed_m_s, "speed", _SPEED
    ),
    OpcUaQuantity(
        f"{_PROCESS}.CrossSection", "m²", "mean cross-section of the load", lambda s: s.area_mm2 * 1e-6,
        record=_read_strip(lambda strip: strip.area_mm2 * 1e-6),
    ),
    OpcUaQuantity(
        f"{_PROCESS}.Load", "kg/m", "mass on the belt per length", _compute_load, absent=_NO_DENSITY
    ),
    OpcUaQuantity(
        f"{_PROCESS}.Filling", "%", "share of the full belt's cross-section",
        lambda s: 100 * s.area_mm2 / s.full_area_mm2 if s.full_area_mm2 else math.nan,
    ),
    OpcUaQuantity(
        f"{_PROCESS}.Coverage", "%", "share of the load that is measured", lambda s: s.coverage * 100
    ),
    OpcUaQuantity(
        f"{_PROCESS}.LargestLump", "mm", "sieve size of the largest lump at the last search",
        lambda s: s.largest_lump_mm, "speed", absent=ua.StatusCodes.BadWaitingForInitialData,
    ),
    OpcUaQuantity(
        f"{_SCALE_PROCESS}.MassFlowRate", "t/h", "mass flow", lambda s: s.mass_flow_t_h, record=_MASS_FLOW,
        absent=_NO_DENSITY, namespace=CONVEYING,
    ),
    OpcUaQuantity(
        f"{_SCALE_PROCESS}.BeltSpeedScale", "m/s", "speed of the belt", lambda s: s.speed_m_s, "speed", _SPEED,
        namespace=CONVEYING,
    ),
    OpcUaQuantity(
        f"{_SCALE}.FlowRate", "t/h", "mass flow", lambda s: s.mass_flow_t_h, record=_MASS_FLOW,
        absent=_NO_DENSITY, namespace=SCALES, kind=MEASURED_ITEM_TYPE,
    ),
    OpcUaQuantity(
        f"{_SCALE}.Speed", "m/s", "speed of the belt", lambda s: s.speed_m_s, "speed", _SPEED, namespace=SCALES
    ),
    OpcUaQuantity(
        f"{_SCALE}.Load", "kg/m", "mass on the belt per length", _compute_load, absent=_NO_DENSITY,
        namespace=SCALES,
    ),
    OpcUaQuantity(
        f"{_SCALE}.MasterTotalizer.TotalizedValue", "t", "mass of all records",
        lambda s: s.totals.mass_kg * 1e-3, "total", absent=_NO_DENSITY, namespace=SCALES,
        kind=MEASURED_ITEM_TYPE,
    ),
    OpcUaQuantity("Belt.Totals.Volume", "m³", "volume of all records", lambda s: s.totals.volume_mm3 * 1e-9, "total"),
    OpcUaQuantity(
        "Belt.Totals.VolumeSigma", "m³", "one standard deviation of the volume",
        lambda s: s.totals.sigma_mm3 * 1e-9, "total",
    ),
    OpcUaQuantity(
        "Belt.Totals.Mass", "t", "mass of all records", lambda s: s.totals.mass_kg * 1e-3, "total",
        absent=_NO_DENSITY,
    ),
    OpcUaQuantity(
        "Belt.Totals.ValidLength", "m", "belt that was measured well", lambda s: s.totals.valid_mm * 1e-3, "total"
    ),
    OpcUaQuantity(
        "Belt.Totals.DegradedLength", "m", "belt that was measured with less certainty",
        lambda s: s.totals.degraded_mm * 1e-3, "total",
    ),
    OpcUaQuantity(
        "Belt.Totals.MissingLength", "m", "belt that was not measured", lambda s: s.totals.missing_mm * 1e-3,
        "total",
    ),
)  # fmt: skip
"""All quantities of the present state."""


@dataclass(frozen=True, slots=True)
class RecordQuantity:
    """One number of a record: the newest at present, all of them in the history."""

    path: str
    unit: str
    """Empty: a count."""
    text: str
    read: ReadRecord

    @property
    def is_count(self) -> bool:
        """Return whether it is a whole number, which is known for every record."""
        return not self.unit

    def find_status(self, record: BeltRecord, value: float) -> int:
        """Return the status of its value."""
        if self.is_count:
            return ua.StatusCodes.Good
        if not math.isfinite(value):
            return _NO_DENSITY
        return _STATUS[record.standing]


RECORD_QUANTITIES: tuple[RecordQuantity, ...] = (
    RecordQuantity("Belt.Records.Number", "", "number of the record", lambda r: r.number),
    RecordQuantity("Belt.Records.Run", "", "number of the program start that wrote it", lambda r: r.run),
    RecordQuantity("Belt.Records.Length", "m", "length of its stretch of belt", lambda r: r.length_mm * 1e-3),
    RecordQuantity("Belt.Records.Volume", "m³", "volume on it", lambda r: r.volume_mm3 * 1e-9),
    RecordQuantity(
        "Belt.Records.VolumeSigma", "m³", "one standard deviation of it", lambda r: r.sigma_mm3 * 1e-9
    ),
    RecordQuantity("Belt.Records.Mass", "kg", "mass on it", lambda r: r.mass_kg),
)
"""All quantities of a record."""
