"""A plant with a history of simulated runs of known mass, whose truth is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.ledger import BeltRecord, FlowRecord, SigmaParts
from beltscape.pipeline.live.measuring_parts import describe_provenance
from beltscape.service.project import open_project
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings

SPAN, DENSITY, ZERO_MM2 = 1.015, 1600.0, 350.0
"""True over measured volume, kg/m³, and the apparent cross-section of the empty belt."""
BELT_M, STRIP_MM = 40.0, 400.0
SPEED_MM_S = 2000.0
BEGIN = datetime(2026, 11, 21, 8, 0, tzinfo=UTC)
BEGIN_NS = int(BEGIN.timestamp()) * 10**9
LOADS = {"half": 60_000.0, "full": 120_000.0}
"""True cross-sections, mm²."""
RUN_M = 60.0
"""Length of belt with load in a run."""
TEST = """name = "autumn test"
operator = "A. Meier"
product = "limestone"
belt_length_m = 40.0

[reference]
name = "bridge 3"
certificate = "D-K 2026-04"
sigma_percent = 0.05
sigma_kg = 1.0
resolution_kg = 1.0
degrees_of_freedom = 50

[density]
kg_m3 = 1600.0
sigma_kg_m3 = 8.0
degrees_of_freedom = 9

"""


class SimulatedPlant:
    """Writes runs one after the other into a history, and the file of their test."""

    def __init__(
        self, folder: Path, seed: int = 49, scatter: float = 0.002, project: Path | None = None
    ) -> None:
        """``project`` is the plant's project.toml; None: one is written, with stand-ins for rig and belt."""
        self.folder, self.rng, self.scatter = folder, np.random.default_rng(seed), scatter
        self.path = folder / "project.toml" if project is None else project
        if project is None:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "rig.json").write_text('{"rig": 1}')
            (folder / "belt.json").write_text('{"belt": 1}')
            (folder / "capture").mkdir()
            self.path.write_text('name = "belt 4"\n[capture]\nfolder = "capture"\nframes_per_s = 5.0\n')
        self.records: list[BeltRecord] = []
        self.run = 1
        self.lines: list[str] = []
        self.certificate = ""

    def pass_belt(self, areas_mm2: Sequence[float], **values: Any) -> tuple[int, int]:
        """Append a strip of every cross-section; return the numbers of the first and the last record."""
        first = len(self.records) + 1
        for area in areas_mm2:
            self.records.append(self._make_record(area, **values))
        return first, len(self.records)

    def _make_record(self, area_mm2: float, *, standing: str = "valid", reason: str = "") -> BeltRecord:
        number = len(self.records) + 1
        belt = (STRIP_MM * (number - 1), STRIP_MM * number)
        noise = float(self.rng.normal(0, 30))
        volume = (area_mm2 / SPAN + ZERO_MM2 + noise) * STRIP_MM
        own, common = 30 * STRIP_MM, 0.004 * volume
        # of the common σ: edges 0.3, holes 0.4, slow depth errors the rest
        parts = SigmaParts(own**2, 0.3 * common, 0.4 * common, math.sqrt(0.75) * common, 0.0)
        strip = FlowRecord(
            frame=f"{number:06d}",
            time_ns=number * 200_000_000,
            belt_position_mm=belt[1],
            strip_mm=belt,
            area_mm2=volume / STRIP_MM,
            volume_mm3=volume,
            sigma_mm3=math.hypot(own, common),
            speed_mm_s=SPEED_MM_S,
            density_kg_m3=DENSITY,
            coverage=0.95,
            single_coverage=0.6,
            quality="measured",
            common_sigma_mm3=common,
            density_sigma_kg_m3=10.0,
            sigma_parts=parts,
        )
        missing = standing == "missing"
        return BeltRecord(
            number=number,
            run=self.run,
            belt_mm=belt,
            standing=standing,  # pyrefly: ignore[bad-argument-type]
            reason=reason,
            wall_ns=BEGIN_NS + number * 200_000_000,
            strip=None if missing else strip,
            run_sigma_mm3=math.nan,
            cameras=5,
            section=None,
            product="limestone",
        )

    def add_zero(self, revolutions: int) -> None:
        first, last = self.pass_belt([0.0] * round(revolutions * BELT_M * 1000 / STRIP_MM))
        self.lines.append(f"[zero]\nrevolutions = {revolutions}\nrecords = [{first}, {last}]\n")

    def add_run(self, load: str) -> float:
        """Append a run and its entry; return its true mass."""
        factor = math.exp(float(self.rng.normal(0, self.scatter)))
        count = round(RUN_M * 1000 / STRIP_MM)
        areas = [0.0] * 5 + [LOADS[load] * factor] * count + [0.0] * 5
        true_m3 = LOADS[load] * 1e-6 * RUN_M
        first, last = self.pass_belt(areas)
        mass = round(true_m3 * DENSITY)
        self.lines.append(
            f'[[runs]]\nload = "{load}"\nmass_kg = {mass}\nticket = "{first}"\nrecords = [{first}, {last}]\n'
        )
        return mass

    def write_history(self) -> None:
        """Write the history."""
        historian = Historian(self.folder / "data", HistorySettings(reserve_mib=1))
        historian.begin_run(describe_provenance(open_project(self.path)))
        historian.write(self.records)
        historian.close()

    def write(self, head: str = TEST) -> Path:
        """Write the history and the test's file; return the file's path."""
        self.write_history()
        path = self.folder / "material_test.toml"
        path.write_text(head + "\n".join(self.lines))
        return path


def make_tested_plant(folder: Path, seed: int = 49) -> tuple[SimulatedPlant, Path]:
    """Return a plant with a zero test and three runs of each load, and the test's file."""
    plant = SimulatedPlant(folder, seed)
    plant.add_zero(3)
    for _ in range(3):
        for load in LOADS:
            plant.add_run(load)
    return plant, plant.write()
