"""The quantities that people type: what each can be and usually is, and the unit that was probably meant."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from ipaddress import ip_address
from math import isfinite, log
from typing import Any, Protocol

Range = tuple[float, float]

UNITS: Mapping[str, tuple[tuple[str, float], ...]] = {
    "mm": (("metres", 1000.0), ("centimetres", 10.0), ("inches", 25.4), ("micrometres", 1e-3)),
    "m": (("millimetres", 1e-3), ("centimetres", 1e-2), ("kilometres", 1e3)),
    "um": (("millimetres", 1e3), ("nanometres", 1e-3), ("metres", 1e6)),
    "mm2": (("m²", 1e6), ("cm²", 100.0)),
    "s": (
        ("milliseconds", 1e-3), ("minutes", 60.0), ("microseconds", 1e-6), ("nanoseconds", 1e-9), ("hours", 3600.0),
    ),
    "ms": (("seconds", 1e3), ("microseconds", 1e-3)),
    "us": (("milliseconds", 1e3), ("seconds", 1e6), ("nanoseconds", 1e-3)),
    "min": (("seconds", 1 / 60), ("hours", 60.0)),
    "m_s": (("mm/s", 1e-3), ("m/min", 1 / 60), ("ft/min", 0.00508)),
    "mm_s": (("m/s", 1e3), ("m/min", 1000 / 60), ("ft/min", 5.08)),
    "kg_m3": (("t/m³", 1e3), ("lb/ft³", 16.018)),
    "deg": (("radians", 57.29578),),
    "percent": (("a share of 1", 100.0),),
    "gib": (("MiB", 1 / 1024), ("bytes", 2.0**-30)),
    "t_h": (("kg/h", 1e-3), ("kg/s", 3.6)),
}  # fmt: skip
"""By a unit as it stands at the end of a setting's name: others that people write there, and their size in it."""
_SIGNS = {
    "um": "µm", "us": "µs", "mm2": "mm²", "m_s": "m/s", "mm_s": "mm/s", "kg_m3": "kg/m³", "percent": "%",
    "gib": "GiB", "t_h": "t/h", "deg": "°", "per_s": "per second",
}  # fmt: skip
"""Units whose sign in a text differs from that in a name."""


def require_host(host: str) -> str:
    """Return the name or address of a machine; ValueError if it can be neither, such as 300.1.2.3 or a URL."""
    if not host or host.isspace():
        raise ValueError("is empty; give a name or an address")
    if set(host) <= set("0123456789.") or ":" in host:
        try:
            ip_address(host.partition("%")[0])
        except ValueError as error:
            fixes = {0: "IPv4 has four numbers from 0 to 255", 1: "give the port in its own key"}
            raise ValueError(f"is no address; {fixes.get(host.count(':'), 'write IPv6 as ::1')}") from error
    elif set(host) & set("/ @[]"):
        raise ValueError("is no name of a machine; give the name or the address alone")
    return host


class ValidationContext(Protocol):
    """The part of pydantic's ``ValidationInfo`` that a check needs."""

    @property
    def context(self) -> Any:
        """A function of setting, value and remark that gives the line of an unusual value, or None: no remarks."""
        ...

    @property
    def field_name(self) -> str | None:
        """The name of the setting."""
        ...


_receiver: ContextVar[Callable[[str], None] | None] = ContextVar("receiver of remarks", default=None)
"""What receives remarks on unusual values, such as the command's reporter: settings are read deep inside."""


@contextmanager
def receive_oddities(receive: Callable[[str], None]) -> Generator[None]:
    """Hand every remark on an unusual value to ``receive`` once, until the end of the context."""
    received: set[str] = set()

    def receive_once(line: str) -> None:
        if line not in received:
            received.add(line)
            receive(line)

    token = _receiver.set(receive_once)
    try:
        yield
    finally:
        _receiver.reset(token)


def report_oddity(line: str) -> None:
    """Hand a remark on an unusual value to what receives them in this context; without it nothing happens."""
    receive = _receiver.get()
    if receive is not None:
        receive(line)


def find_unit(key: str) -> str:
    """Return the unit at the end of a setting's name, such as "mm_s" of speed_mm_s; empty without a known one."""
    return max((unit for unit in UNITS if key.endswith(f"_{unit}")), key=len, default="")


def suggest_unit(value: float, unit: str, fits: Callable[[float], bool], most: int = 1) -> str:
    """Return "; in metres? write 200" for the first unit, or the ``most``, in which the value fits; else empty."""
    found = [(name, value * factor) for name, factor in UNITS.get(unit, ()) if fits(value * factor)]
    return "".join(f"; in {name}? write {_round(converted)}" for name, converted in found[:most])


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity that people type, in a unit."""

    name: str
    """With its article, such as "the height of a load"."""
    unit: str
    """As at the end of a setting's name."""
    possible: Range
    """Values outside cannot be."""
    usual: Range
    """Values outside are worth a remark."""
    is_zero_possible: bool = False
    """Whether 0 is a value of its own, such as none."""

    def find_refusal(self, value: float) -> str:
        """Return why a value cannot be, what can be and the unit that was probably meant; empty if it can be."""
        if self._contains(self.possible, value):
            return ""
        if not isfinite(value):
            return "must be a finite number"
        if value <= 0:
            return "must not be negative" if self.is_zero_possible else "must be greater than 0"
        return f"cannot be {self._describe(value, self.possible)}"

    def find_oddity(self, value: float) -> str:
        """Return why a possible value is unusual, what is usual and the unit that was probably meant; or empty."""
        if not self._contains(self.possible, value) or self._contains(self.usual, value):
            return ""
        return f"is unusual for {self._describe(value, self.usual)}"

    def check(self, value: float, info: ValidationContext) -> float:
        """Return the value of a setting; ValueError if it cannot be. An unusual one is reported."""
        if refusal := self.find_refusal(value):
            raise ValueError(refusal)
        if (oddity := self.find_oddity(value)) and callable(info.context):
            report_oddity(str(info.context(info.field_name, value, oddity)))
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Return pydantic's schema of a number with this check: ``Annotated[float, LOAD_HEIGHT]`` is a setting."""
        function = {"type": "with-info", "function": self.check, "field_name": handler.field_name}
        return {"type": "function-after", "function": function, "schema": handler(source)}

    def _contains(self, limits: Range, value: float) -> bool:
        return limits[0] <= value <= limits[1] or (self.is_zero_possible and value == 0)

    def _describe(self, value: float, limits: Range) -> str:
        low, high = self.usual
        sign = _SIGNS.get(self.unit, self.unit)
        hint = suggest_unit(value, self.unit, lambda converted: low <= converted <= high, 2)
        return f"{self.name} in {sign} ({_format(limits[0])} to {_format(limits[1])}){hint}"


_USUAL_RIG = ((30.0, 2.2), (900.0, 2.2), (250.0, 2.5))
"""Square and distance of a board, and the farthest distance of two cameras, of rigs over belts: a usual value in mm
and the factor by which it spreads. They tell units apart, whose sizes differ by 2.5 and more. Chosen."""
_CLEARER = 4.0
"""A unit is likelier than mm from this difference of the squared deviations on: e² in probability."""
_ALMOST = 3.0
"""The second unit is named as well where it is less likely by no more than this difference."""


def guess_unit_of_board(square_mm: float, distance_mm: float, baseline_mm: float) -> list[tuple[str, float]]:
    """Return the units, with their size in mm, in which a board's squares were probably given; none: in mm.

    The board was ``distance_mm`` away and the cameras up to ``baseline_mm`` apart, by these squares.
    """

    def deviation(factor: float) -> float:
        values = (square_mm, distance_mm, baseline_mm)
        pairs = zip(values, _USUAL_RIG, strict=True)
        return sum(
            (log(max(value, 1e-9) * factor / usual) / log(spread)) ** 2 for value, (usual, spread) in pairs
        )

    ranked = sorted(UNITS["mm"], key=lambda unit: deviation(unit[1]))
    best = deviation(ranked[0][1])
    if deviation(1.0) - best < _CLEARER:
        return []
    return [unit for unit in ranked[:2] if deviation(unit[1]) - best < _ALMOST]


_STILL_MM_S, _FAST_MM_S, _IMPOSSIBLE_MM_S = 10.0, 15_000.0, 50_000.0
"""Below the first no conveyor moves, the second is beyond the fastest, the third beyond any encoder's slip. A belt of
up to 10 m/s with times in ms, or positions in m, is below the first."""
_SELDOM_S = 8.0
"""Frames this far apart come from no running belt; up to 125 a second their times in ms are farther apart. Chosen."""
_REGULAR = 0.1
"""Intervals and speeds of a running belt differ by a smaller share; those of a belt moved by hand by more."""
_SHORT_S, _LONG_S = 0.005, 0.5
"""Frames farther apart than the second may have times in ms, nearer than the first in minutes or hours. Chosen."""
_LIKELY_S, _LIKELY_MM_S = (0.001, 5.0), (30.0, 12_000.0)
"""Intervals of frames and speeds of belts that a unit must lead to in order to be suggested."""
_POSITIONS = tuple(unit for unit in UNITS["mm"] if unit[0] != "inches")
"""Units in which positions of a belt may be given; inches are too near to centimetres to be told by a speed."""


def find_motion_faults(interval_s: float, speed_mm_s: float, spread: float) -> tuple[str, str]:
    """Return why frames at an interval of a belt at a speed cannot be, and what is unusual in them; empty if nothing.

    ``speed_mm_s`` is that of the moving belt; 0: it never moves. ``spread`` is the share by which intervals or speeds
    differ, whichever is more: a belt that is moved by hand from frame to frame is as slow as one with times in ms.
    """
    if speed_mm_s == 0 or _STILL_MM_S <= speed_mm_s <= _FAST_MM_S:
        return "", ""
    times = [
        (name, factor)
        for name, factor in UNITS["s"]
        if (interval_s > _LONG_S if factor < 1 else interval_s < _SHORT_S)
        and _is_likely(interval_s * factor, speed_mm_s / factor)
    ]
    places = [(name, factor) for name, factor in _POSITIONS if _is_likely(interval_s, speed_mm_s * factor)]
    fixes = [
        *(f"; timestamp_s in {name}? multiply by {_round(factor)}" for name, factor in times),
        *(f"; belt_position_mm in {name}? multiply by {_round(factor)}" for name, factor in places),
    ]
    if speed_mm_s > _FAST_MM_S and not times:
        fixes.append("; belt_position_mm in pulses? multiply by the mm of a pulse")
    text = f"rows every {_round(interval_s)} s at {_round(speed_mm_s)} mm/s{''.join(fixes[:2])}"
    if speed_mm_s > _IMPOSSIBLE_MM_S or (times and interval_s > _SELDOM_S and spread < _REGULAR):
        return f"no belt has {text}", ""
    return "", f"few belts have {text}"


def _is_likely(interval_s: float, speed_mm_s: float) -> bool:
    return _LIKELY_S[0] <= interval_s <= _LIKELY_S[1] and _LIKELY_MM_S[0] <= speed_mm_s <= _LIKELY_MM_S[1]


def _round(value: float) -> str:
    """Return a converted value with four digits; more would repeat the rounding of a unit's size."""
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"


def _format(value: float) -> str:
    return f"{value:.6g}" if abs(value) < 1e6 or not isfinite(value) else f"{value:.0f}"


LOAD_HEIGHT = Quantity("the height of a load", "mm", (2, 5000), (20, 1500))
"""Loads are some hundred mm high; in metres they are below 1.5, so that 2 separates the two."""
BELT_WIDTH = Quantity("a width of belt", "mm", (20, 20_000), (150, 4000))
"""Belts are 300 to 3200 mm wide (ISO 251), those of laboratories 100 and more; in metres all are below 20."""
TOP_WIDTH = Quantity("the width of a load's top", "mm", (3, 20_000), (20, 4000))
"""A load may end in a ridge or be as wide as the belt; in metres all widths are below 3."""
RIG_HEIGHT = Quantity("the height of a camera over the belt", "mm", (30, 20_000), (150, 8000))
"""Rigs hang 0.5 to 3 m high; in metres all are below 30."""
BASELINE = Quantity("the distance of two cameras", "mm", (2, 20_000), (20, 20_000))
"""Planned rigs have 100 to 1000 mm; the limit of 2 is that of a rig's baselines."""
DISTANCE = Quantity("a distance from the camera", "mm", (10, 100_000), (100, 30_000))
"""Surfaces nearer than 10 mm are within the lens; in metres all distances of rigs are below it or near it."""
BOX_SIDE = Quantity("the side of a box on the belt", "mm", (5, 100_000), (5, 100_000))
"""Narrower boxes hold a few points only; in metres boxes on belts are below 5."""
SQUARE = Quantity("the edge of a board's square", "mm", (0.6, 1000), (3, 300))
"""Boards of rigs have squares of 5 to 100 mm; in metres those are below 0.3, in inches below 12."""
MARKER = Quantity("the edge of a board's marker", "mm", (0.4, 1000), (2, 300))
"""Markers take two thirds of their squares; in metres they are below 0.3."""
SOLID = Quantity("the size of a module's solid", "mm", (2, 2000), (5, 1000))
"""Solids that a rig measures are 20 to 200 mm large; in metres they are below 2."""
MODULE_SIDE = Quantity("the side of a module's base", "mm", (5, 5000), (60, 3000))
"""The paper's base is 285 mm long; in metres bases are below 5, in centimetres mostly below 60."""
PLATE = Quantity("the thickness of a plate", "mm", (0.2, 500), (0.5, 200))
"""Plates in metres are below 0.2."""
LUMP = Quantity("the size of a lump", "mm", (1, 3000), (5, 1500))
"""Lumps that block a chute are some 50 to 1000 mm large; in metres they are below 1.5, mostly below 1."""
SIEVE = Quantity("the aperture of a sieve", "mm", (0.3, 3000), (0.3, 3000))
"""Cameras over a belt show no grains below 0.3 mm; in metres apertures are below it."""
CELL = Quantity("the edge of a cell", "mm", (0.02, 100), (0.1, 60))
"""Cells are one or some pixels, 0.2 to 3 mm; in metres they are below 0.02."""
PROFILE = Quantity("the distance of two cross-sections", "mm", (0.5, 10_000), (5, 2000))
"""Some cross-sections to a view of 300 to 1000 mm."""
STRETCH = Quantity("a length of belt", "mm", (3, 100_000), (20, 20_000))
"""Lengths that the flow is cut into; in metres they are below 3."""
DENSITY = Quantity("a bulk density", "kg_m3", (5, 30_000), (40, 9000))
"""Foam beads have 15, iron ore 3000; in t/m³ all are below 5. Tungsten has 19,300."""
DENSITY_SIGMA = Quantity("the σ of a bulk density", "kg_m3", (0, 10_000), (0.3, 2000), is_zero_possible=True)
"""A percent of 100 to 3000 kg/m³ and more; in t/m³ below 0.3."""
BELT_SPEED = Quantity("the speed of a belt", "m_s", (0.005, 20), (0.05, 12), is_zero_possible=True)
"""Belts run at 0.1 to 8 m/s, the fastest at 12."""
BELT_SPEED_MM = Quantity("the speed of a belt", "mm_s", (10, 20_000), (50, 12_000), is_zero_possible=True)
"""Belts run at 0.1 to 8 m/s, the fastest at 12; in m/s all are below 20 and mostly below 10."""
FASTEST_SPEED = Quantity("the fastest speed of a belt", "mm_s", (50, 50_000), (200, 50_000))
"""Twice as fast as any belt, to let an encoder slip; in m/s below 50."""
STOPPED_SPEED = Quantity("the speed of a stopped belt", "mm_s", (0.1, 5000), (1, 500))
"""A stopped belt creeps by some mm/s; in m/s that is below 0.1."""
EXPOSURE = Quantity("an exposure time", "us", (1, 1e7), (15, 200_000))
"""Flashes of projectors last 20 µs and more; in milliseconds exposures are 0.05 to 20."""
FRAME_RATE = Quantity("a rate of frames", "per_s", (0.001, 1000), (0.05, 500))
"""Cameras over belts give 1 to 200 frames a second."""
CROSS_SECTION = Quantity("the cross-section of a load", "mm2", (20, 1e8), (500, 1e7))
"""Loads have 1,000 to 1,000,000 mm²; in m² they are below 5, in cm² 10 to 10,000."""
CARRY_BACK = Quantity("the cross-section of carry-back", "mm2", (2, 1e6), (20, 1e5))
"""Some hundred mm² are worth a report; in m² that is below 0.1, in cm² below 1000."""
OFFSET = Quantity("the misalignment of a belt", "mm", (1, 3000), (3, 600))
"""Belts run off by some ten mm; in metres that is below 1."""
ZERO_SHIFT = Quantity("a shift of the belt's zero", "mm", (0.005, 1000), (0.02, 200))
"""Belts wear by tenths of a mm and rise by some mm; in metres that is below 0.005."""
BELT_LENGTH = Quantity("the length of an endless belt", "m", (1, 50_000), (3, 20_000))
"""Belts are 5 m to 20 km long; in mm they are above 3000."""
MOISTURE = Quantity("a share of water", "percent", (0, 100), (0.2, 80), is_zero_possible=True)
"""Bulk materials hold 1 to 50 %; as a share of 1 below 0.5."""
SCALE_SIGMA = Quantity("the σ of a belt scale", "percent", (0.01, 50), (0.05, 20))
"""Scales of classes 0.2 to 2 (OIML R 50) keep 0.1 to 2 %; as a share of 1 below 0.05."""
DISK_SPACE = Quantity("a size on the disk", "gib", (0, 1e6), (0.0001, 50_000))
"""Disks have up to some ten TiB; in MiB or bytes sizes are above."""
ENCODER_STEP = Quantity("the travel of a count", "mm", (1e-6, 1000), (5e-4, 400))
"""Encoders on pulleys give 0.001 to 10 mm per count, a switch once a turn some 100; in metres below 5e-4."""
