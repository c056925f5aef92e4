"""encoder.csv, density tables, products and flow.csv: contents and refused files."""

from __future__ import annotations

from pathlib import Path

import pytest

from beltscape.core.errors import InputError
from beltscape.core.ledger import FlowRecord
from beltscape.core.quantities import receive_oddities
from beltscape.files.density import find_product, read_density_table
from beltscape.files.encoder_csv import read_encoder
from beltscape.files.flow_csv import HEADER, format_flow_row, write_flow

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


def belt(scale_s: float = 1, scale_mm: float = 1, start_s: float = 0) -> str:
    """Return an encoder.csv of a belt at 2 m/s, which stands at first, with times and positions in other units."""
    rows = (f"{k},{start_s + 0.05 * k * scale_s},{100 * max(0, k - 3) * scale_mm}\n" for k in range(8))
    return GOOD + "".join(rows)


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
        (
            GOOD + "a,0,05,12,5\n",
            "line 2: 5 values, but the header has 3; decimal commas? write numbers with a",
        ),
        (GOOD + 'a,"0,05",12\n', "line 2: timestamp_s '0,05' is not a number; write 0.05"),
        (GOOD + "a,0,1_000\n", "line 2: belt_position_mm '1_000' is not a number"),
        (GOOD + "a;0,05;12,5\n", "line 2: timestamp_s '05;12' is not a number"),
        (GOOD.replace(",", ";") + "a;0,05;12,5\n", "separate the columns by commas and write numbers with a"),
        (GOOD.replace(",", "\t"), "separate the columns by commas"),
        (
            belt(scale_s=1e3),
            "no belt has rows every 50 s at 2 mm/s; timestamp_s in milliseconds? multiply by 0.001",
        ),
        (belt(scale_s=1e6), "timestamp_s in microseconds? multiply by 1e-06"),
        (belt(scale_s=1e9), "timestamp_s in nanoseconds? multiply by 1e-09"),
        (belt(scale_s=1e3, start_s=1.76e12), "timestamp_s 1.76e+12 is after the year 2100"),
        (belt(scale_s=1 / 3600), "timestamp_s in hours? multiply by 3600"),
        (
            belt(scale_mm=1e3),
            "no belt has rows every 0.05 s at 2000000 mm/s; belt_position_mm in micrometres?",
        ),
        (
            belt(scale_mm=50),
            "multiply by 0.001; belt_position_mm in pulses? multiply by the mm of a pulse",
        ),
    ],
)
def test_a_wrong_encoder_file_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError) as error:
        read_encoder(path)
    assert words in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


MOVED_BY_HAND = GOOD + "a,0,0\nb,31,80\nc,58,175\nd,97,240\ne,123,330\nf,152,395\n"


@pytest.mark.parametrize(
    ("text", "oddity"),
    [
        (belt(), ""),
        (GOOD + "a,0,7\nb,60,7\n", ""),  # a standing belt
        (GOOD + "a,0,0\nb,2,1000\n", ""),
        (
            belt(scale_mm=1e-3),
            "few belts have rows every 0.05 s at 2 mm/s; belt_position_mm in metres? multiply by 1000",
        ),
        (GOOD + "a,0,0\nb,1,2\nc,2,4\n", "few belts have rows every 1 s at 2 mm/s"),
        (belt(scale_mm=10), "few belts have rows every 0.05 s at 20000 mm/s"),
        (MOVED_BY_HAND, "few belts have rows every 29 s at 2.581 mm/s; timestamp_s in milliseconds?"),
    ],
)
def test_an_unusual_motion_is_read_with_a_remark(tmp_path: Path, text: str, oddity: str) -> None:
    lines: list[str] = []
    with receive_oddities(lines.append):
        assert read_encoder(written(tmp_path, text))
    assert bool(lines) == bool(oddity)
    assert oddity in "".join(lines)


def test_a_belt_may_roll_back(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD + "a,0,0\nb,1,0\nc,2,-400\nd,3,200\ne,4,900\nf,5,850\n")
    assert [reading.belt_position_mm for reading in read_encoder(path)] == [0, 0, -400, 200, 900, 850]


def test_density_by_time(tmp_path: Path) -> None:
    path = written(tmp_path, "timestamp_s,density_kg_m3,sigma_kg_m3\n0,800,10\n1.5,900,12\n", "density.csv")
    assert read_density_table(path) == [(0, 800.0, 10.0), (1_500_000_000, 900.0, 12.0)]
    for row, words in (
        ("0,-5", "line 2: density_kg_m3 -5 must be greater than 0"),
        ("0,1.6", r"1.6 cannot be a bulk density in kg/m³ \(5 to 30000\); in t/m³\? write 1600"),
        ("0,800,5,1", "line 2: 4 values, but the header has 2; decimal commas"),
    ):
        path = written(tmp_path, f"timestamp_s,density_kg_m3\n{row}\n", "density.csv")
        with pytest.raises(InputError, match=words):
            read_density_table(path)
    path = written(tmp_path, "timestamp_s,density_kg_m3,sigma_kg_m3\n0,5,800\n", "density.csv")
    with pytest.raises(InputError, match="sigma_kg_m3 800 is not below density_kg_m3 5; decimal commas"):
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
