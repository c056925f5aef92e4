"""The counter of a belt scale: from a growing table or from the registers of its controller.

A thread reads it, and tells where scale and known density disagree.
"""

from __future__ import annotations

import math
import struct
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from time import time_ns
from typing import Protocol

from beltscape.core.errors import BeltscapeError, InputError, describe_missing_library
from beltscape.core.supervision import make_supervised_thread
from beltscape.files.paths import parse_decimal
from beltscape.production.scale import ScaleReading
from beltscape.production.settings import ScaleModbusSettings, ScaleSettings
from beltscape.report.production.document import BatchOut
from beltscape.service.production.figures import ProductionFigures
from beltscape.sinks.historian import Historian

_FORMS: Mapping[str, tuple[int, str]] = {
    "uint16": (1, ">H"),
    "uint32": (2, ">I"),
    "uint64": (4, ">Q"),
    "float32": (2, ">f"),
    "float64": (4, ">d"),
}
"""Number of registers and packing of a form."""
_TIMEOUT_S = 3.0
"""Time for the controller to answer."""
_READ_BYTES = 1 << 19
"""Most of a table that is read at once: some 20,000 rows."""
_LAST_S, _MOST_KG = 4_102_444_800, 1e15
"""The beginning of 2100, and a mass beyond any counter."""


class ScaleError(BeltscapeError):
    """The counter cannot be read now; the next attempt may succeed."""


class ScaleCounter(Protocol):
    """A source of readings."""

    def read(self) -> list[ScaleReading]:
        """Return the new readings; ScaleError if there are none because of a fault."""
        ...

    def close(self) -> None:
        """End the connection."""
        ...


class TableCounter:
    """The rows ``timestamp_s,kg`` of a table that another program appends to."""

    def __init__(self, path: Path, after_ns: int) -> None:
        """Begin behind the reading at ``after_ns``."""
        self._path, self._after_ns, self._offset, self._wrong_row = path, after_ns, 0, ""

    def read(self) -> list[ScaleReading]:
        """Return the readings of whole new rows; a row that is none is left out, and told by the next call."""
        if self._wrong_row:
            wrong, self._wrong_row = self._wrong_row, ""
            raise ScaleError(
                f"[scale] csv: {self._path}: {wrong!r} is no row timestamp_s,kg with decimal points; it is left out"
            )
        try:
            with self._path.open("rb") as file:
                if file.seek(0, 2) < self._offset:
                    self._offset = 0  # a new table in its place
                file.seek(self._offset)
                data = file.read(_READ_BYTES)
        except OSError as error:
            raise ScaleError(f"[scale] csv: {self._path}: {error.strerror or error}") from error
        whole = data[: data.rfind(b"\n") + 1]
        if not whole and len(data) == _READ_BYTES:
            whole = data  # no line end in all of it: no table
        self._offset += len(whole)
        rows = (line.strip() for line in whole.decode("utf-8", "replace").split("\n"))
        found = [self._parse(row) for row in rows if row and row.replace(" ", "") != "timestamp_s,kg"]
        new = [reading for reading in found if reading is not None and reading.wall_ns > self._after_ns]
        if new:
            self._after_ns = max(reading.wall_ns for reading in new)
        return new

    def _parse(self, row: str) -> ScaleReading | None:
        cells = [parse_decimal(cell) for cell in row.split(",")]
        seconds, kg = cells if len(cells) == 2 else (None, None)
        if seconds is not None and kg is not None and 0 <= seconds < _LAST_S and abs(kg) < _MOST_KG:
            return ScaleReading(round(seconds * 1e9), kg, "csv")
        self._wrong_row = row[:60]
        return None

    def close(self) -> None:
        """Do nothing: no file is open between calls."""


class ModbusCounter:
    """The counter in the registers of a scale's controller, read as a client."""

    def __init__(self, settings: ScaleModbusSettings) -> None:
        """Prepare; InputError if the library is missing."""
        try:
            from pymodbus.client import ModbusTcpClient
        except ImportError as error:
            raise InputError(f"[scale.modbus]: {describe_missing_library(error) or error}") from error
        self._settings = settings
        self._client = ModbusTcpClient(settings.host, port=settings.port, timeout=_TIMEOUT_S, retries=0)

    def read(self) -> list[ScaleReading]:
        """Return the present reading."""
        from pymodbus.exceptions import ModbusException

        settings = self._settings
        words, packing = _FORMS[settings.form]
        read = self._client.read_holding_registers
        if settings.kind == "input":
            read = self._client.read_input_registers
        where = f"[scale.modbus] {settings.host} port {settings.port}"
        try:
            if not self._client.connected and not self._client.connect():
                raise ScaleError(f"{where}: no answer")
            answer = read(settings.address, count=words, device_id=settings.unit)
        except (ModbusException, OSError) as error:
            self._client.close()
            raise ScaleError(f"{where}: {' '.join(str(error).split())}") from error
        if answer.isError() or len(answer.registers) != words:
            raise ScaleError(f"{where}: register {settings.address} is refused")
        registers = answer.registers if settings.words == "big" else answer.registers[::-1]
        (count,) = struct.unpack(packing, struct.pack(f">{words}H", *registers))
        if not math.isfinite(count):
            raise ScaleError(f"{where}: register {settings.address} holds {count}, no count")
        return [ScaleReading(time.time_ns(), count * settings.kg_per_count, "modbus")]

    def close(self) -> None:
        """End the connection."""
        self._client.close()


def check_scale(settings: ScaleSettings) -> str:
    """Return where the counter comes from; InputError if the library that reads it is missing."""
    if settings.modbus is not None:
        ModbusCounter(settings.modbus).close()
        return f"{settings.modbus.host} port {settings.modbus.port}, register {settings.modbus.address}"
    if settings.csv is None:
        return "its counter is typed on the page"
    return f"{settings.csv}{'' if settings.csv.is_file() else ', which does not exist yet'}"


_BATCHES = 20
"""Newest batches that are compared; an older one changes no more unless a reading is typed for it."""
_EVENT = "scale"
_EVENTS = 10_000
"""Newest events among which those of a scale are searched: more than a plant has in a week."""
_END_OF_TIME_NS = 1 << 62
"""A time after every event."""
_WEEK_NS = 7 * 86_400 * 10**9
"""A batch that ended earlier is not told any more."""


class ScaleWatch:
    """Reads the counter and compares new batches until it is closed."""

    def __init__(
        self,
        figures: ProductionFigures,
        historian: Historian,
        counter: ScaleCounter | None,
        every_s: float,
        on_message: Callable[[str], None],
    ) -> None:
        """``counter``: None where a person types it."""
        self._figures, self._historian, self._counter = figures, historian, counter
        self._every_s, self._on_message = every_s, on_message
        self._stop, self._trouble = threading.Event(), ""
        events = historian.events(0, _END_OF_TIME_NS, _EVENTS)
        self._reported = {event.name for event in events if event.kind == _EVENT}
        self._thread = make_supervised_thread("scale", self._run, self._tell, self._stop.wait)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self, patience_s: float = 5.0) -> None:
        """Stop it."""
        self._stop.set()
        self._thread.join(patience_s)
        if self._counter is not None:
            self._counter.close()

    def _run(self) -> None:
        while True:
            try:
                self.read()
                self.compare(time_ns())
                self._trouble = ""
            except BeltscapeError as error:
                self._tell(str(error))
            if self._stop.wait(self._every_s):
                return

    def read(self) -> None:
        """Store the counter's new readings."""
        if self._counter is not None:
            self._figures.control.history.add_readings(self._counter.read())

    def compare(self, now_ns: int) -> None:
        """Tell the complete batches of the last week whose weighing disagrees with the known density, once each."""
        for batch in self._figures.list_batches(now_ns - _WEEK_NS, now_ns, _BATCHES):
            if batch.scale is not None and batch.scale.disagrees and batch.complete:
                self._report(batch, now_ns)

    def _report(self, batch: BatchOut, now_ns: int) -> None:
        name, scale = str(batch.number), batch.scale
        if name in self._reported or scale is None or scale.deviation_t is None:
            return
        self._reported.add(name)
        deviation = f"{scale.deviation_t:+.3f} ± {scale.deviation_sigma_t:.3f} t"
        text = f"batch {batch.name}: belt scale and known density disagree: {deviation}"
        values: dict[str, object] = {
            "batch": batch.name,
            "deviation": scale.deviation_t,
            "sigma": scale.deviation_sigma_t,
        }
        self._figures.control.events.add(_EVENT, name, text, now_ns, parameters=values)
        self._on_message(text)

    def _tell(self, trouble: str) -> None:
        if trouble != self._trouble:
            self._trouble = trouble
            self._on_message(trouble)
