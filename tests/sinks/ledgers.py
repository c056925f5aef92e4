"""Belt records for the sinks' tests."""

from __future__ import annotations

import numpy as np

from beltscape.core.ledger import QUALITIES, BeltRecord, CrossSection, FlowRecord, standing_from_quality

START_NS = 1_790_000_000_000_000_000
"""2026-09-21T14:13:20Z."""
GRID = np.arange(-600, 601, 4, dtype=np.float32)


def section(seed: int) -> CrossSection:
    """A heap across the belt with noise and a hole; heights in whole steps, as they are kept."""
    rng = np.random.default_rng(seed)
    height = np.maximum(
        0, 200 * np.cos(GRID / 700) + 20 * np.sin(GRID / 80 + seed) + rng.normal(0, 0.5, GRID.size)
    )
    height = (np.rint(height * 32) / 32).astype(np.float32)
    height[40:47] = np.nan
    return CrossSection(GRID, height)


def strip(seed: int, start_mm: float, end_mm: float, *, density: float = 1600.0) -> FlowRecord:
    rng = np.random.default_rng(seed)
    area = float(rng.uniform(5e4, 2e5))
    return FlowRecord(
        frame=f"{seed:06d}",
        time_ns=seed * 200_000_000,
        belt_position_mm=end_mm,
        strip_mm=(start_mm, end_mm),
        area_mm2=area,
        volume_mm3=area * (end_mm - start_mm),
        sigma_mm3=area * 2.0,
        speed_mm_s=(end_mm - start_mm) * 5.0,
        density_kg_m3=density,
        coverage=float(rng.uniform(0.7, 1)),
        single_coverage=0.6,
        quality=QUALITIES[int(rng.choice(3, p=[0.8, 0.1, 0.1]))],
    )


def ledger(
    count: int,
    first: int = 1,
    run: int = 1,
    *,
    start_ns: int = START_NS,
    every_ns: int = 200_000_000,
    sections: bool = True,
    length_mm: float = 300.0,
) -> list[BeltRecord]:
    """``count`` records from number ``first``; every seventh is missing, without a strip."""
    return [
        record(number, run, start_ns + (number - first) * every_ns, sections=sections, length_mm=length_mm)
        for number in range(first, first + count)
    ]


def record(
    number: int, run: int, wall_ns: int, *, sections: bool = True, length_mm: float = 300.0
) -> BeltRecord:
    # the same float for every record
    belt = (0.1 + (number - 1) * length_mm, 0.1 + number * length_mm)
    absent = number % 7 == 0
    measured = None if absent else strip(number, *belt)
    standing = "missing" if measured is None else standing_from_quality(measured.quality)
    return BeltRecord(
        number=number,
        run=run,
        belt_mm=belt,
        standing=standing,
        reason="" if standing == "valid" else "no frames, for a test",
        wall_ns=wall_ns,
        strip=measured,
        run_sigma_mm3=1e6 * number,
        cameras=0 if absent else 5,
        section=section(number) if sections and not absent else None,
        offset_mm=0.0 if number < 20 else 4711.25,
    )


def same(one: BeltRecord, other: BeltRecord, *, sections: bool = True) -> bool:
    """Whether two records agree in everything; NaN equals NaN."""

    def plain(value: BeltRecord) -> str:
        return repr(
            (
                value.number,
                value.run,
                value.belt_mm,
                value.standing,
                value.reason,
                value.wall_ns,
                value.strip,
                value.run_sigma_mm3,
                value.cameras,
                value.offset_mm,
            )
        )

    return plain(one) == plain(other) and (not sections or same_section(one.section, other.section))


def same_section(one: CrossSection | None, other: CrossSection | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one.x_mm, other.x_mm) and np.array_equal(
        one.height_mm, other.height_mm, equal_nan=True
    )
