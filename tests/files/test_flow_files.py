"""encoder.csv, density tables, products and flow.csv: contents and refused files."""

from __future__ import annotations

from pathlib import Path

import pytest

from beltscape.core.belt.flow_record import FlowRecord
from beltscape.core.errors import InputError
from beltscape.files.tables.density import find_product, read_density_table
from beltscape.files.tables.encoder_csv import read_encoder
from beltscape.files.tables.flow_csv import HEADER, format_flow_row, write_flow

GOOD = "frame,timestamp_s,belt_position_mm\n"


def written(tmp_path: Path, text: str, name: str = "encoder.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_frames_may_be_named_by_their_files(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD + "000.png,0.0,0.0\n001,0.2000001,201.2\n\n")
    first, second = read_encoder(path)
    assert (first.frame, second.frame) == ("000", "001")
    assert second.time_ns == 200_000_100
    assert second.belt_position_mm == 201.2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("frame,time,position\n0,0,0\n", "the header is 'frame,time,position'; it must be frame,timestamp_s"),
        ("", "the header is ''"),
        (GOOD, "no row below the header"),
        (GOOD + "a,0,0\na,1,1\n", "line 3: frame a is there twice (also in line 2)"),
        (GOOD + "a,1,0\nb,1,1\n", "line 3: timestamp_s 1 is not after"),
        (
            GOOD + "a,0,5\nb,1,4\n",
            "belt_position_mm falls from the first row to the last; positions must grow",
        ),
        (
            GOOD + "a,0,5\nb,1,4000\nc,2,900\n",
            "line 4: belt_position_mm 900 is 3.1 m behind the farthest before it",
        ),
        (GOOD + "a,0,x\n", "line 2: belt_position_mm 'x' is not a number"),
        (GOOD + "a,0,nan\n", "line 2: belt_position_mm 'nan' is not a number"),
        (GOOD + "a,0\n", "line 2: 2 values, but the header has 3"),
        (GOOD + ",0,0\n", "line 2: no frame is named"),
    ],
)
def test_a_wrong_encoder_file_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError) as error:
        read_encoder(path)
    assert words in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_belt_may_roll_back(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD + "a,0,0\nb,1,0\nc,2,-400\nd,3,200\ne,4,900\nf,5,850\n")
    assert [reading.belt_position_mm for reading in read_encoder(path)] == [0, 0, -400, 200, 900, 850]


def test_density_by_time(tmp_path: Path) -> None:
    path = written(tmp_path, "timestamp_s,density_kg_m3,sigma_kg_m3\n0,800,10\n1.5,900,12\n", "density.csv")
    assert read_density_table(path) == [(0, 800.0, 10.0), (1_500_000_000, 900.0, 12.0)]
    path = written(tmp_path, "timestamp_s,density_kg_m3\n0,-5\n", "density.csv")
    with pytest.raises(InputError, match="line 2: a density of -5"):
        read_density_table(path)


def test_products_are_read_by_name(tmp_path: Path) -> None:
    path = written(tmp_path, "[coal]\ndensity_kg_m3 = 850\nsigma_kg_m3 = 20\n", "products.toml")
    assert find_product(path, "coal").density_kg_m3 == 850
    with pytest.raises(InputError, match="no product coall; did you mean coal"):
        find_product(path, "coall")
    path = written(tmp_path, "coal = 850\n", "products.toml")
    with pytest.raises(InputError, match="coal = 850"):
        find_product(path, "coal")


def test_flow_csv_has_empty_cells_for_unknown_values(tmp_path: Path) -> None:
    nan = float("nan")
    known = FlowRecord(
        "000", 1_500_000_000, 10.0, (0.0, 10.0), 20.0, 200.0, 1.0, 1000.0, 1600.0, 0.9, 0.8, "measured"
    )
    lost = FlowRecord("001", None, nan, (10.0, 10.0), nan, 0.0, 0.0, nan, nan, 0.0, 0.0, "missing")
    assert format_flow_row(known) == "000,1.500000,10.0000,20.000,200.000,0.072000,0.115200,0.9000,measured"
    assert format_flow_row(lost) == "001,,,,0.000,,,0.0000,missing"
    write_flow(tmp_path / "flow.csv", [known, lost])
    assert (tmp_path / "flow.csv").read_text().splitlines()[0] == HEADER
