"""A simulated plant that sends events to observers and records to a ledger, as a real one does."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Protocol

import numpy as np

from beltscape.core.alarms import Alarm
from beltscape.core.errors import MeasureError
from beltscape.core.events import BeltStretch, CameraHealth, Capacity, FrameEvent, Maintenance, ZeroProposal
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.interfaces import Observer
from beltscape.core.ledger import BeltRecord, CrossSection, FlowRecord, Standing, Totals
from tests.service.alarm_controls import SimulatedAlarmControls

CAMERAS = ("cam1", "cam2", "cam3", "cam4", "cam5")
CAPACITY = Capacity(6.0, 4200.0)
_CELL_MM = 5.0
_X_MM = np.arange(-500, 500.1, _CELL_MM).astype(np.float32)


class Ledger(Protocol):
    """Receives records, as the historian does."""

    @property
    def totals(self) -> Totals: ...

    def write(self, records: Sequence[BeltRecord]) -> None: ...


class SummingLedger:
    """A ledger that keeps only the totals."""

    def __init__(self) -> None:
        self.totals = Totals()

    def write(self, records: Sequence[BeltRecord]) -> None:
        for record in records:
            key = f"{record.standing}_mm"
            self.totals = replace(
                self.totals,
                records=self.totals.records + 1,
                volume_mm3=self.totals.volume_mm3 + record.volume_mm3,
                sigma_mm3=self.totals.sigma_mm3 + record.sigma_mm3,
                mass_kg=self.totals.mass_kg + record.mass_kg,
                since_ns=self.totals.since_ns or record.wall_ns,
                **{key: getattr(self.totals, key) + record.length_mm},
            )


@lru_cache(256)
def make_heights(start_mm: float, rows: int, seed: int = 7) -> np.ndarray:
    """Return (rows, Nx) heights of a piece of belt, read-only: a heap of varying size with lumps; deterministic."""
    s = start_mm + np.arange(rows) * _CELL_MM
    level = 0.78 + 0.09 * np.sin(s / 19_000) + 0.05 * np.sin(s / 5300 + 1) + 0.03 * np.sin(s / 700)
    half = 330 * np.sqrt(level)[:, None]
    across = np.clip(1 - (np.abs(_X_MM[None, :] + 14 * np.sin(s / 1900)[:, None]) / half) ** 2.2, 0, None)
    load = 150 * level[:, None] * across
    for block in range(int(s[0] // 500), int(s[-1] // 500) + 1):
        rng = np.random.default_rng([seed, block + 10_000])
        for _ in range(26):
            centre, x = block * 500 + rng.uniform(0, 500), rng.normal(0, 150)
            radius, tall = rng.gamma(3, 14) + 14, rng.uniform(0.35, 0.7)
            if radius > 80 or abs(x) > 0.85 * half.mean():
                continue
            at = slice(*np.searchsorted(s, (centre - radius, centre + radius)))
            by = slice(*np.searchsorted(_X_MM, (x - radius, x + radius)))
            away = ((s[at, None] - centre) / radius) ** 2 + ((_X_MM[None, by] - x) / radius) ** 2
            stone = tall * radius * np.sqrt(np.clip(1 - away, 0, None))
            if stone.size:
                load[at, by] = np.maximum(load[at, by], (stone > 0) * load[at, by].mean() + stone)
    rng = np.random.default_rng([seed, int(s[0]) + 1_000_000])
    heights = (load + rng.normal(0, 0.8, load.shape)).astype(np.float32)
    heights.flags.writeable = False
    return heights


def make_picture(camera: int, position_mm: float, *, size: tuple[int, int] = (300, 400)) -> np.ndarray:
    """Return (H, W) uint8 an image of the belt."""
    h = make_heights(position_mm - 1500, 300)
    shade = 120 + 9 * np.gradient(h, axis=0) + 7 * np.gradient(h, axis=1) + 0.25 * h
    rows = np.linspace(0, h.shape[0] - 1, size[0]).astype(int)
    columns = np.clip(np.linspace(-20 + 6 * camera, h.shape[1] + 20 - 6 * camera, size[1]), 0, h.shape[1] - 1)
    return np.clip(shade[np.ix_(rows, columns.astype(int))], 0, 255).astype(np.uint8)


class SimulatedPlant:
    """A belt at 2.4 m/s; every call of ``step`` moves it by ``step_mm`` and sends a frame."""

    def __init__(
        self, observers: Sequence[Observer], ledger: Ledger, *, number: int = 0, belt_mm: float = 0.0
    ) -> None:
        self.observers, self.ledger = observers, ledger
        self.number, self.belt_mm, self.done = number, belt_mm, 0
        self.speed_mm_s, self.step_mm = 2400.0, 480.0
        self.lost: set[str] = set()
        self.kept: list[tuple[str, str]] = []
        self.zeros: list[tuple[int, str]] = []
        self.learned_by: list[str] = []
        self.zero_refusal = ""
        """Why the zero cannot be measured; empty: it can."""
        self.degraded = self.stopped = False
        self.alarms: dict[str, Alarm] = {}
        self.alarm_controls = SimulatedAlarmControls(self.alarms, self._send_alarms)
        self.maintenance: Maintenance | None = None

    def step(self, wall_ns: int | None = None) -> None:
        """Simulate one trigger instant."""
        wall_ns = time.time_ns() if wall_ns is None else wall_ns
        self.done += 1
        self._send_frame()
        if not self.stopped:
            self._measure(wall_ns)
        if self.done % 5 == 1:
            self.send_health()

    def _send_frame(self) -> None:
        images = {
            name: make_picture(i, self.belt_mm)
            for i, name in enumerate(CAMERAS)
            if name not in self.lost and self.done % 5 == 1
        }
        frames = FrameSet(f"{self.done:06d}", images, self.done * 200_000_000, self.belt_mm)
        seconds = 0.16 + 0.03 * np.sin(self.done)
        speed = 0.0 if self.stopped else self.speed_mm_s
        event = FrameEvent(
            frames, self.done, self.done // 400, 0, float(seconds), 0.964, speed, capacity=CAPACITY
        )
        for observer in self.observers:
            observer.on_frame(event)

    def _measure(self, wall_ns: int) -> None:
        rows = round(self.step_mm / _CELL_MM)
        load = make_heights(self.belt_mm, rows)
        measured = np.random.default_rng([3, self.done]).random(load.shape) > 0.02
        if self.degraded:
            measured &= np.abs(_X_MM)[None, :] < 260
        area = float(np.clip(load, 0, None).mean(axis=0).sum() * _CELL_MM)
        volume, coverage = area * self.step_mm, float(measured.mean())
        standing: Standing = "degraded" if self.degraded else "valid"
        self.number += 1
        strip = FlowRecord(
            f"{self.done:06d}", None, self.belt_mm, (self.belt_mm, self.belt_mm + self.step_mm), area, volume,
            volume * 0.012, self.speed_mm_s, 1650.0, coverage, coverage * 0.9,
            "degraded" if self.degraded else "measured",
        )  # fmt: skip
        section = np.where(measured.mean(axis=0) > 0.5, load.mean(axis=0), np.nan).astype(np.float32)
        record = BeltRecord(
            self.number, 1, (self.belt_mm, self.belt_mm + self.step_mm), standing,
            "one camera missing" if self.degraded else "", wall_ns, strip, volume * 0.012 * self.number,
            len(CAMERAS) - len(self.lost), CrossSection(_X_MM, section),
        )  # fmt: skip
        self.ledger.write([record])
        stretch = BeltStretch(self.belt_mm, _CELL_MM, _X_MM, load, measured)
        self.belt_mm += self.step_mm
        for observer in self.observers:
            observer.on_records([record], self.ledger.totals)
            observer.on_surface(stretch)

    def send_health(self) -> None:
        """Send the cameras' health."""
        cameras = {
            name: CameraHealth(
                name, "lost" if name in self.lost else "ok", self.done, 0, 0.0 if name in self.lost else 5.0,
                0.02 * i, "no image for 4 s: check its power and cable" if name in self.lost else "",
            )
            for i, name in enumerate(CAMERAS)
        }  # fmt: skip
        for observer in self.observers:
            observer.on_health(cameras)

    # core.interfaces.Controls

    def raise_alarm(self, alarm: Alarm) -> None:
        """Raise an alarm."""
        self.alarms[alarm.name] = alarm
        self._send_alarms()

    def acknowledge(self, alarm: str, by: str) -> bool:
        """See core.interfaces.Controls."""
        current = self.alarms.get(alarm)
        if current is None or current.state not in ("raised", "gone"):
            return False
        state = "acknowledged" if current.state == "raised" else "clear"
        self.alarms[alarm] = replace(current, state=state, by=by)
        self._send_alarms()
        return True

    def keep_recording(self, reason: str, by: str) -> bool:
        """See core.interfaces.Controls."""
        self.kept.append((reason, by))
        return True

    def begin_maintenance(self, reason: str, minutes: float, by: str) -> bool:
        """See core.interfaces.Controls."""
        now_ns = time.time_ns()
        self.maintenance = Maintenance(reason, by, now_ns, now_ns + round(minutes * 60e9))
        for observer in self.observers:
            observer.on_maintenance(self.maintenance)
        return True

    def end_maintenance(self, by: str) -> bool:
        """See core.interfaces.Controls."""
        was, self.maintenance = self.maintenance, None
        for observer in self.observers:
            observer.on_maintenance(None)
        return was is not None

    def learn_images(self, by: str) -> bool:
        """See core.interfaces.Controls."""
        self.learned_by.append(by)
        return True

    def measure_zero(self) -> ZeroProposal:
        """See core.interfaces.Controls."""
        if self.zero_refusal:
            raise MeasureError(self.zero_refusal)
        return ZeroProposal(7, 0.42, 0.05, -0.61, 5, 2.0)

    def set_zero(self, number: int, by: str) -> bool:
        """See core.interfaces.Controls."""
        self.zeros.append((number, by))
        return number == 7

    def send_findings(self, findings: Sequence[Finding]) -> None:
        """Send findings."""
        for observer in self.observers:
            observer.on_findings(findings)

    def _send_alarms(self) -> None:
        for observer in self.observers:
            observer.on_alarms(tuple(self.alarms.values()))


class PlantThread:
    """Runs a plant in a thread, five frames per second."""

    def __init__(self, plant: SimulatedPlant, *, hz: float = 5.0) -> None:
        self.plant, self._hz = plant, hz
        self._stop = threading.Event()
        self.paused = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(1 / self._hz):
            if not self.paused.is_set():
                self.plant.step()

    def close(self) -> None:
        """Stop the thread."""
        self._stop.set()
        self._thread.join(5)
