from __future__ import annotations

import os

from hypothesis import given
from hypothesis import strategies as st

from beltscape.sources.encoder.growing import GrowingFile


def append(path, data: bytes):
    with path.open("ab") as file:
        file.write(data)


@given(st.lists(st.integers(0, 10**6), max_size=30), st.lists(st.integers(1, 12), max_size=60))
def test_lines_come_once_whole_and_in_order_however_they_are_written(tmp_path_factory, numbers, cuts):
    path = tmp_path_factory.mktemp("growing") / "encoder.csv"
    path.write_bytes(b"")
    growing = GrowingFile(path)
    data = "".join(f"{number}\n" for number in numbers).encode()
    found = []
    for cut in [*cuts, len(data) + 1]:
        append(path, data[:cut])
        data = data[cut:]
        found += growing.lines()
    growing.close()
    assert found == [str(number) for number in numbers]


def test_what_was_there_before_is_left_out_but_for_the_line_being_written(tmp_path):
    path = tmp_path / "encoder.csv"
    append(path, b"1\n2\n123")
    growing = GrowingFile(path)
    assert growing.lines() == []
    append(path, b"45\n6")
    assert growing.lines() == ["12345"]
    append(path, b"\r\n")
    assert growing.lines() == ["6"]
    growing.close()


def test_a_large_file_is_not_read_through(tmp_path):
    path = tmp_path / "encoder.csv"
    append(path, b"1234567\n" * 100_000)
    growing = GrowingFile(path)
    append(path, b"8\n")
    assert growing.lines() == ["8"]
    growing.close()


def test_a_file_that_comes_later_is_read_from_its_beginning(tmp_path):
    path = tmp_path / "encoder.csv"
    growing = GrowingFile(path)
    assert growing.lines() == []
    append(path, b"1\n2\n")
    assert growing.lines() == ["1", "2"]
    growing.close()


def test_a_rotated_file_is_read_to_its_end_and_then_the_new_one(tmp_path):
    path = tmp_path / "encoder.csv"
    append(path, b"")
    growing = GrowingFile(path)
    append(path, b"1\n2\n")
    path.rename(tmp_path / "encoder.csv.1")
    append(tmp_path / "encoder.csv.1", b"3\nhalf")
    append(path, b"4\n")
    assert growing.lines() == ["1", "2", "3", "4"]
    append(path, b"5\n")
    assert growing.lines() == ["5"]
    growing.close()


def test_a_file_emptied_in_place_is_read_from_its_beginning(tmp_path):
    path = tmp_path / "encoder.csv"
    append(path, b"")
    growing = GrowingFile(path)
    append(path, b"100\n200\n3")
    assert growing.lines() == ["100", "200"]
    os.truncate(path, 0)
    append(path, b"4\n")
    assert growing.lines() == ["4"]
    growing.close()


def test_a_file_that_is_removed_and_comes_again(tmp_path):
    path = tmp_path / "encoder.csv"
    append(path, b"")
    growing = GrowingFile(path)
    append(path, b"1\n")
    path.unlink()
    assert growing.lines() == ["1"]
    assert growing.lines() == []
    append(path, b"2\n")
    assert growing.lines() == ["2"]
    growing.close()


def test_a_line_without_end_takes_no_memory(tmp_path):
    path = tmp_path / "encoder.csv"
    append(path, b"")
    growing = GrowingFile(path)
    for _ in range(5):
        append(path, b"x" * 2_000_000)
        assert growing.lines() == []
    assert len(growing._rest) <= 1 << 16
    append(path, b"\n7\n")
    assert growing.lines()[-1] == "7"
    growing.close()


def test_a_line_that_comes_between_the_last_look_and_the_renaming_is_read(tmp_path):
    path, old = tmp_path / "encoder.csv", tmp_path / "encoder.csv.1"

    class Raced(GrowingFile):
        def _replaced(self):
            path.rename(old)
            append(old, b"2\n")
            append(path, b"3\n")
            return super()._replaced()

    append(path, b"")
    growing = Raced(path)
    append(path, b"1\n")
    assert growing.lines() == ["1", "2", "3"]
    growing.close()
