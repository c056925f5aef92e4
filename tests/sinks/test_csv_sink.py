"""Daily CSV files: rows, repair of a truncated end, clock changes."""

from __future__ import annotations

import csv
import io
import os
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError, OutputError
from beltscape.files.flow_csv import HEADER as FLOW_HEADER
from beltscape.files.flow_csv import format_flow_row
from beltscape.sinks.csv_sink import FIRST_HEADER, HEADER, CsvSink, read_last_number, read_records
from beltscape.sinks.settings import CsvSettings
from tests.optional import require
from tests.sinks.ledgers import START_NS, ledger
from tests.thorough import examples

DAY_NS = 86_400_000_000_000
SETTINGS = CsvSettings(enabled=True)


def rows(folder) -> list[dict[str, str]]:
    """All rows of all files, in order of the records."""
    found = [
        row for path in folder.glob("*.csv") for row in csv.DictReader(io.StringIO(path.read_text("utf-8")))
    ]
    return sorted(found, key=lambda row: int(row["number"]))


def test_a_row_is_flow_csvs_and_the_ledgers(tmp_path):
    record = ledger(1)[0]
    sink = CsvSink(tmp_path, SETTINGS)
    sink.write([record])
    header, line = (tmp_path / "2026-09-21.csv").read_text("utf-8").splitlines()
    assert header == HEADER and header.startswith(FLOW_HEADER)
    assert line.startswith(format_flow_row(require(record.strip)) + ",1,1,0.1000,300.1000,")
    (row,) = rows(tmp_path)
    assert row["wall_time_s"] == f"{START_NS // 10**9}.000000"
    assert row["standing"] == record.standing


def test_a_row_names_product_and_batch(tmp_path):
    records = [replace(record, product="ore, wet", batch=4) for record in ledger(2)]
    CsvSink(tmp_path, SETTINGS).write([*records, *ledger(1, 3)])
    assert [(row["product"], row["batch"]) for row in rows(tmp_path)] == [("ore, wet", "4")] * 2 + [("", "")]
    (path,) = tmp_path.glob("*.csv")
    assert [(r.product, r.batch) for r in read_records(path, 0, 0.1)] == [("ore, wet", 4)] * 2 + [("", 0)]


def test_a_file_of_an_earlier_version_goes_on_with_its_columns(tmp_path):
    path = tmp_path / "2026-09-21.csv"
    CsvSink(tmp_path, SETTINGS).write(ledger(2))
    lines = [line.rsplit(",", 2)[0] for line in path.read_text("utf-8").splitlines()]
    assert lines[0] == FIRST_HEADER
    path.write_text("\n".join(lines) + "\n", "utf-8")
    sink = CsvSink(tmp_path, SETTINGS)
    assert sink.last == 2
    sink.write([replace(record, product="ore", batch=4) for record in ledger(2, 3)])
    assert [row["number"] for row in rows(tmp_path)] == ["1", "2", "3", "4"]
    assert path.read_text("utf-8").splitlines()[0] == FIRST_HEADER
    assert read_last_number(path) == 4
    sink.write(ledger(1, 5, start_ns=START_NS + DAY_NS))
    assert (tmp_path / "2026-09-22.csv").read_text("utf-8").startswith(HEADER + "\n")


def test_missing_belt_has_a_row(tmp_path):
    records = ledger(7)
    assert records[6].strip is None
    CsvSink(tmp_path, SETTINGS).write(records)
    row = rows(tmp_path)[6]
    assert row["frame"] == row["volume_mm3"] == ""
    assert row["quality"] == row["standing"] == "missing"
    assert row["belt_to_mm"] == "2100.1000"


def test_words_with_commas_and_ends_of_lines_stay_one_cell(tmp_path):
    record = ledger(1)[0]
    record = replace(record, reason='lost "cam2",\ncam3', strip=replace(require(record.strip), frame="a,b"))
    CsvSink(tmp_path, SETTINGS).write([record])
    (row,) = rows(tmp_path)
    assert (row["reason"], row["frame"]) == ('lost "cam2", cam3', "a,b")
    assert CsvSink(tmp_path, SETTINGS).last == 1


@examples(40)
@given(st.integers(0, 5000), st.integers(1, 8))
def test_truncated_tail_is_repaired_without_duplicates(tmp_path_factory, cut, more):
    folder = tmp_path_factory.mktemp("csv")
    records = ledger(12, every_ns=DAY_NS // 5, sections=False)
    CsvSink(folder, SETTINGS).write(records[:8])
    newest = max(folder.glob("*.csv"))
    data = newest.read_bytes()
    newest.write_bytes(data[: max(0, len(data) - cut % (len(data) + 1))])
    sink = CsvSink(folder, SETTINGS)
    assert sink.last <= 8
    sink.write(records[sink.last : 8])
    sink.write(records[: 8 + more % 5])
    sink.write(records)
    found = rows(folder)
    assert [int(row["number"]) for row in found] == list(range(1, 13))
    assert all(None not in row and None not in row.values() for row in found)


def test_clock_set_back_keeps_the_order_of_records(tmp_path):
    shifts = [0, 0, -2 * DAY_NS, -2 * DAY_NS, 0, 3650 * DAY_NS, 0]
    records = [replace(r, wall_ns=r.wall_ns + s) for r, s in zip(ledger(7), shifts, strict=True)]
    sink = CsvSink(tmp_path, SETTINGS)
    for record in records:
        sink.write([record])
    assert sorted(p.stem for p in tmp_path.glob("*.csv")) == ["2026-09-19", "2026-09-21", "2036-09-18"]
    assert CsvSink(tmp_path, SETTINGS).last == 7
    assert [int(row["number"]) for row in rows(tmp_path)] == list(range(1, 8))


def test_oldest_files_are_removed_by_their_record_numbers(tmp_path):
    sink = CsvSink(tmp_path, CsvSettings(enabled=True, days=3))
    records = ledger(6, every_ns=DAY_NS)
    # the clock of the last days is in 1970
    records = [*records[:4], *(replace(r, wall_ns=r.wall_ns - START_NS) for r in records[4:])]
    for record in records:
        sink.write([record])
    assert [int(row["number"]) for row in rows(tmp_path)] == [4, 5, 6]


def test_partial_write_leaves_no_partial_line(tmp_path, monkeypatch):
    import pathlib

    records = ledger(20)
    sink = CsvSink(tmp_path, SETTINGS)
    sink.write(records[:10])
    before = (tmp_path / "2026-09-21.csv").read_bytes()
    opened = pathlib.Path.open

    class Filling:
        """Takes 100 bytes, then the disk is full."""

        def __init__(self, file) -> None:
            self.file, self.left = file, 100

        def __enter__(self):
            return self

        def __exit__(self, *_) -> None:
            self.file.close()

        def write(self, data: bytes) -> int:
            if not self.left:
                raise OSError(28, "No space left on device")
            done, self.left = self.file.write(data[: self.left]), 0
            return done

    def open_(path, mode="r", *args, **kwargs):
        file = opened(path, mode, *args, **kwargs)
        return Filling(file) if mode == "ab" else file

    monkeypatch.setattr(pathlib.Path, "open", open_)
    with pytest.raises(OutputError, match="No space left"):
        sink.write(records[10:])
    monkeypatch.undo()
    assert (tmp_path / "2026-09-21.csv").read_bytes() == before
    sink.write(records[10:])
    assert [int(row["number"]) for row in rows(tmp_path)] == list(range(1, 21))


def test_foreign_file_is_not_changed(tmp_path):
    (tmp_path / "2026-09-21.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="header"):
        CsvSink(tmp_path, SETTINGS)
    (tmp_path / "2026-09-21.csv").write_text(f"{HEADER}\nnonsense\n")
    with pytest.raises(InputError, match="no record"):
        CsvSink(tmp_path, SETTINGS)
    assert os.listdir(tmp_path) == ["2026-09-21.csv"]  # noqa: PTH208


def test_days_begin_at_the_set_hour(tmp_path):
    sink = CsvSink(tmp_path, CsvSettings(enabled=True, day_begins_utc_h=-10))
    sink.write(ledger(1))
    assert [p.name for p in tmp_path.iterdir()] == ["2026-09-22.csv"]
