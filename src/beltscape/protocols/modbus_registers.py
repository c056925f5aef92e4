"""The map of registers: name, address, form, unit and meaning of every value, and its words."""

from __future__ import annotations

import csv
import io
import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

from beltscape.core.errors import InputError
from beltscape.protocols.plant import PlantState
from beltscape.protocols.settings import ModbusSettings

Form = Literal["uint16", "uint32", "uint64", "int64", "float32"]
_WORDS: Mapping[Form, int] = {"uint16": 1, "uint32": 2, "uint64": 4, "int64": 4, "float32": 2}
_PACKING: Mapping[Form, str] = {
    "uint16": ">H",
    "uint32": ">I",
    "uint64": ">Q",
    "int64": ">q",
    "float32": ">f",
}
_QUALITY = {"missing": 0, "degraded": 1, "valid": 2}
_ZERO_UA, _FULL_UA, _BROKEN_UA, _MOST_UA = 4000, 20_000, 3500, 20_500
"""Current loop of 4 to 20 mA: 3.5 mA signals a fault, 20.5 mA a value beyond the scale (NAMUR NE 43)."""


@dataclass(frozen=True, slots=True)
class RegisterValues:
    """The values that the registers are filled from."""

    state: PlantState
    heartbeat: int
    """Seconds that the server has run."""
    pulses: int
    done: int = 0
    """Newest request that was taken."""
    result: int = 0
    """What became of it."""


@dataclass(frozen=True, slots=True)
class Register:
    """One value of the map."""

    name: str
    form: Form
    unit: str
    meaning: str
    read: Callable[[RegisterValues, ModbusSettings], float]
    address: int = 0
    """Of its first word."""

    @property
    def words(self) -> int:
        """Return the number of 16-bit registers that it takes."""
        return _WORDS[self.form]

    def pack(self, reading: RegisterValues, settings: ModbusSettings) -> list[int]:
        """Return its words; an integer beyond its form wraps around, as counters do."""
        value = self.read(reading, settings)
        if self.form == "float32":
            data = struct.pack(">f", value)
        elif self.form == "int64":
            data = struct.pack(">q", round(value))
        else:
            data = struct.pack(_PACKING[self.form], round(value) % (1 << (16 * self.words)))
        words = list(struct.unpack(f">{self.words}H", data))
        return words if settings.words == "big" else words[::-1]


@dataclass(frozen=True, slots=True)
class CommandRegister:
    """A register that the control system writes."""

    name: str
    form: str
    words: int
    meaning: str
    address: int
    unit: str = ""


def _compute_analogue(reading: RegisterValues, settings: ModbusSettings) -> float:
    """Return the flow on the current loop, µA."""
    state = reading.state
    if settings.full_t_h is not None:
        flow, full = state.mass_flow_t_h, settings.full_t_h
    elif settings.full_m3_h is not None:
        flow, full = state.volume_flow_m3_h, settings.full_m3_h
    else:
        return _BROKEN_UA
    if not math.isfinite(flow) or state.standing == "missing":
        return _BROKEN_UA
    return min(max(_ZERO_UA + (_FULL_UA - _ZERO_UA) * flow / full, _ZERO_UA), _MOST_UA)


def _count_alarms(severity: str) -> Callable[[RegisterValues, ModbusSettings], float]:
    def count(reading: RegisterValues, _: ModbusSettings) -> float:
        alarms = reading.state.alarms
        return sum(
            alarm.severity == severity and alarm.state in ("raised", "acknowledged") for alarm in alarms
        )

    return count


def _count_cameras(reading: RegisterValues, _: ModbusSettings) -> float:
    return sum(camera.state == "ok" for camera in reading.state.cameras)


def _find_product(reading: RegisterValues, _: ModbusSettings) -> float:
    """Return the number of the present product, from 1; 0 without one."""
    state = reading.state
    return state.products.index(state.product) + 1 if state.product in state.products else 0


def _scale(value: float, factor: float) -> float:
    return value * factor if math.isfinite(value) else 0.0


REGISTERS: tuple[Register, ...] = (
    Register(
        "heartbeat", "uint16", "s", "grows by one a second while the service runs", lambda r, _: r.heartbeat
    ),
    Register(
        "quality",
        "uint16",
        "",
        "2 good, 1 uncertain, 0 bad: the present flow",
        lambda r, _: _QUALITY[r.state.standing],
    ),
    Register(
        "flow_m3_h", "float32", "m³/h", "volume flow; NaN: not known", lambda r, _: r.state.volume_flow_m3_h
    ),
    Register(
        "flow_sigma_m3_h",
        "float32",
        "m³/h",
        "one standard deviation of it",
        lambda r, _: r.state.volume_flow_sigma_m3_h,
    ),
    Register("flow_t_h", "float32", "t/h", "mass flow; NaN: not known", lambda r, _: r.state.mass_flow_t_h),
    Register(
        "flow_sigma_t_h",
        "float32",
        "t/h",
        "one standard deviation of it",
        lambda r, _: r.state.mass_flow_sigma_t_h,
    ),
    Register(
        "speed_m_s", "float32", "m/s", "speed of the belt; NaN: not known", lambda r, _: r.state.speed_m_s
    ),
    Register(
        "load_m2",
        "float32",
        "m²",
        "mean cross-section of the load; NaN: not known",
        lambda r, _: r.state.area_mm2 * 1e-6,
    ),
    Register(
        "coverage", "float32", "", "share of the load that is measured, 0 to 1", lambda r, _: r.state.coverage
    ),
    Register("record", "uint32", "", "number of the newest record", lambda r, _: r.state.record),
    Register(
        "total_volume_l",
        "int64",
        "l",
        "volume of all records",
        lambda r, _: _scale(r.state.totals.volume_mm3, 1e-6),
    ),
    Register(
        "total_mass_kg",
        "int64",
        "kg",
        "mass of all records; 0 without a density",
        lambda r, _: _scale(r.state.totals.mass_kg, 1.0),
    ),
    Register(
        "total_valid_mm", "uint64", "mm", "belt that was measured", lambda r, _: r.state.totals.valid_mm
    ),
    Register(
        "total_degraded_mm",
        "uint64",
        "mm",
        "belt that was measured with less certainty",
        lambda r, _: r.state.totals.degraded_mm,
    ),
    Register(
        "total_missing_mm",
        "uint64",
        "mm",
        "belt that was not measured",
        lambda r, _: r.state.totals.missing_mm,
    ),
    Register(
        "pulses",
        "uint32",
        "",
        "pulses of pulse_kg or pulse_l; never falls, wraps at 2³²",
        lambda r, _: r.pulses,
    ),
    Register("analogue_ua", "uint16", "µA", "flow as 4000 to 20,000 µA; 3500: not known", _compute_analogue),
    Register("alarms_critical", "uint16", "", "critical alarms that are on", _count_alarms("critical")),
    Register("alarms_warning", "uint16", "", "warnings that are on", _count_alarms("warning")),
    Register("cameras_ok", "uint16", "", "cameras without a fault", _count_cameras),
    Register(
        "maintenance", "uint16", "", "1 during maintenance, else 0", lambda r, _: r.state.maintenance != ""
    ),
    Register("product", "uint16", "", "number of the present product; 0: none", _find_product),
    Register("batch", "uint16", "", "1 while a batch is open, else 0", lambda r, _: r.state.batch != ""),
    Register("command_done", "uint16", "", "newest request that was taken", lambda r, _: r.done),
    Register(
        "command_result",
        "uint16",
        "",
        "1 done, 2 refused, 3 no heartbeat; 0: none since the start",
        lambda r, _: r.result,
    ),
)


def place_registers(settings: ModbusSettings) -> tuple[Register, ...]:
    """Return the registers with their addresses, in the order of these.

    Raises
    ------
    InputError
        If an address names no register, or two registers overlap.
    """
    if not settings.addresses:
        address, placed = settings.first, list[Register]()
        for register in REGISTERS:
            placed.append(replace(register, address=address))
            address += register.words
        return tuple(placed)
    by_name = {register.name: register for register in REGISTERS}
    for name in settings.addresses:
        if name not in by_name:
            raise InputError(f"[modbus.addresses]: {name} is no register; there are {', '.join(by_name)}")
    found = [replace(by_name[name], address=address) for name, address in settings.addresses.items()]
    found.sort(key=lambda register: register.address)
    for one, two in pairwise(found):
        if one.address + one.words > two.address:
            raise InputError(
                f"[modbus.addresses]: {one.name} takes the addresses {one.address} to "
                f"{one.address + one.words - 1}, and {two.name} begins at {two.address}"
            )
    return tuple(found)


def write_csv(registers: Sequence[Register | CommandRegister]) -> str:
    """Return the map as a table for the engineering tool of a control system."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["address", "name", "form", "words", "unit", "meaning"])
    for register in registers:
        writer.writerow([
            register.address, register.name, register.form, register.words, register.unit, register.meaning,
        ])  # fmt: skip
    return text.getvalue()
