"""The parts of a strip's common σ: kept by database and day files, summed, unknown in what older programs wrote."""

from __future__ import annotations

from dataclasses import replace

import pyarrow.parquet as pq
import pytest

from beltscape.core.ledger import BeltRecord, SigmaParts
from beltscape.sinks.historian import Historian, database
from beltscape.sinks.historian.day_files import read_day
from beltscape.sinks.historian.records import from_row, to_row
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import START_NS, ledger

ALWAYS = (0, 1 << 62)
HOUR_NS = 3600 * 10**9
PARTS = SigmaParts(25.0, 4.0, 8.0, 4.0, 0.0, 48**0.5)


def make_records(count: int = 30, **values: int) -> list[BeltRecord]:
    """Records whose σ of 13 has an own part of 5 and a common one of 12, of edges, holes, drift and scale."""
    return [
        one
        if one.strip is None
        else replace(one, strip=replace(one.strip, sigma_mm3=13.0, common_sigma_mm3=12.0, sigma_parts=PARTS))
        for one in ledger(count, sections=False, **values)
    ]


def test_parts_read_back_from_database_and_day_file(tmp_path) -> None:
    historian, records = Historian(tmp_path, HistorySettings(reserve_mib=1)), make_records(every_ns=HOUR_NS)
    historian.write(records)
    historian.maintain(records[-1].wall_ns)
    sums = historian.production.product_sums(START_NS - HOUR_NS, START_NS + 100 * HOUR_NS)[""]
    strips = [one.strip for one in historian.records(0, 1 << 62)]
    historian.close()
    measured = [one for one in strips if one is not None]
    assert [one.sigma_parts for one in measured] == [PARTS] * len(measured)
    assert (sums.edges_mm3, sums.drift_mm3, sums.faults_mm3, sums.scale_mm3) == pytest.approx(
        (4 * len(measured), 4 * len(measured), 0, PARTS.scale_mm3 * len(measured))
    )
    assert sums.unsplit_mm3 == 0
    path = tmp_path / "days" / "2026-09-21.parquet"
    from_file = [one.strip for one in read_day(path, ALWAYS, ALWAYS, 1000, sections=False)]
    assert all(one.sigma_parts.holes_mm3 == 8.0 for one in from_file if one is not None)
    table = pq.read_table(path)
    pq.write_table(
        table.drop_columns(
            [name for name in table.column_names if name[:5] in ("edges", "holes", "drift", "fault", "scale")]
        ),
        path,
    )
    older = [one.strip for one in read_day(path, ALWAYS, ALWAYS, 1000, sections=False)]
    assert all(one.sigma_parts == SigmaParts() for one in older if one is not None)


def test_what_an_older_program_wrote_is_not_split(tmp_path, monkeypatch) -> None:
    with monkeypatch.context() as older:
        older.setattr(database, "MIGRATIONS", database.MIGRATIONS[:5])
        connection = database.open_writer(tmp_path / "history.db")
    names = "minute, product, batch, records, volume_mm3, variance_mm6, common_mm3, weighed_kg, unweighed, "
    names += "mass_variance_kg2, mass_common_kg, density_common_kg, valid_mm, degraded_mm, missing_mm"
    values = (
        START_NS // (60 * 10**9) + 1,
        "coal",
        0,
        5,
        1e9,
        4.0,
        7e6,
        800.0,
        0,
        1.0,
        2.0,
        3.0,
        1e3,
        0.0,
        0.0,
    )
    marks = ", ".join("?" * len(values))
    connection.execute(f"INSERT INTO production_sums ({names}) VALUES ({marks})", values)
    connection.close()
    historian = Historian(tmp_path, HistorySettings(reserve_mib=1))
    sums = historian.production.product_sums(START_NS, START_NS + HOUR_NS)["coal"]
    historian.close()
    assert (sums.unsplit_mm3, sums.edges_mm3, sums.common_mm3) == (7e6, 0.0, 7e6)


def test_the_scale_is_a_part_that_a_database_of_version_6_gains(tmp_path, monkeypatch) -> None:
    with monkeypatch.context() as older:
        older.setattr(database, "MIGRATIONS", database.MIGRATIONS[:6])
        database.open_writer(tmp_path / "history.db").close()
    historian = Historian(tmp_path, HistorySettings(reserve_mib=1))
    historian.write(make_records(3))
    strips = [one.strip for one in historian.records(0, 1 << 62)]
    historian.close()
    assert {one.sigma_parts.scale_mm3 for one in strips if one is not None} == {PARTS.scale_mm3}


def test_a_part_that_was_not_kept_is_zero() -> None:
    row = to_row(next(one for one in make_records(3) if one.strip is not None))
    strip = from_row(row._replace(scale_sigma=None)).strip
    assert strip is not None
    assert strip.sigma_parts == replace(PARTS, scale_mm3=0.0)
