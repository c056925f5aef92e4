"""Lines that another program appends to a file, rotated or recreated."""

from __future__ import annotations

import os

from hypothesis import given
from hypothesis import strategies as st

from beltscape.sources.encoder.tail import FileTail


def append(path, data: bytes):
    with path.open("ab") as file:
        file.write(data)


@given(st.lists(st.integers(0, 10**6), max_size=30), st.lists(st.integers(1, 12), max_size=60))
def test_lines_are_returned_once_complete_and_in_order(tmp_path_factory, numbers, cuts):
    path = tmp_path_factory.mktemp("tail") / "encoder.csv"
    path.write_bytes(b"")
    tail = FileTail(path)
    data = "".join(f"{number}\n" for number in numbers).encode()
    found = []
    for cut in [*cuts, len(data) + 1]:
        append(path, data[:cut])
        data = data[cut:]
        found += tail.read_lines()
    tail.close()
    assert found == [str(number) for number in numbers]


def test_present_lines_are_skipped_except_the_incomplete_one(tmp_path):
    path = tmp_path / "encoder.csv"
    append(path, b"1\n2\n123")
    tail = FileTail(path)
    assert tail.read_lines() == []
    append(path, b"45\n6")
    assert tail.read_lines() == ["12345"]
    append(path, b"\r\n")
    assert tail.read_lines() == ["6"]
    tail.close()


def test_a_large_file_is_not_read_through(tmp_path):
    path = tmp_path / "encoder.csv"
    append(path, b"1234567\n" * 100_000)
    tail = FileTail(path)
    append(path, b"8\n")
    assert tail.read_lines() == ["8"]
    tail.close()


def test_later_file_is_read_from_its_beginning(tmp_path):
    path = tmp_path / "encoder.csv"
    tail = FileTail(path)
    assert tail.read_lines() == []
    append(path, b"1\n2\n")
    assert tail.read_lines() == ["1", "2"]
    tail.close()


def test_a_rotated_file_is_read_to_its_end_and_then_the_new_one(tmp_path):
    path = tmp_path / "encoder.csv"
    append(path, b"")
    tail = FileTail(path)
    append(path, b"1\n2\n")
    path.rename(tmp_path / "encoder.csv.1")
    append(tmp_path / "encoder.csv.1", b"3\nhalf")
    append(path, b"4\n")
    assert tail.read_lines() == ["1", "2", "3", "4"]
    append(path, b"5\n")
    assert tail.read_lines() == ["5"]
    tail.close()


def test_a_file_emptied_in_place_is_read_from_its_beginning(tmp_path):
    path = tmp_path / "encoder.csv"
    append(path, b"")
    tail = FileTail(path)
    append(path, b"100\n200\n3")
    assert tail.read_lines() == ["100", "200"]
    os.truncate(path, 0)
    append(path, b"4\n")
    assert tail.read_lines() == ["4"]
    tail.close()


def test_removed_and_recreated_file_is_read(tmp_path):
    path = tmp_path / "encoder.csv"
    append(path, b"")
    tail = FileTail(path)
    append(path, b"1\n")
    path.unlink()
    assert tail.read_lines() == ["1"]
    assert tail.read_lines() == []
    append(path, b"2\n")
    assert tail.read_lines() == ["2"]
    tail.close()


def test_a_line_without_end_takes_no_memory(tmp_path):
    path = tmp_path / "encoder.csv"
    append(path, b"")
    tail = FileTail(path)
    for _ in range(5):
        append(path, b"x" * 2_000_000)
        assert tail.read_lines() == []
    assert len(tail._rest) <= 1 << 16
    append(path, b"\n7\n")
    assert tail.read_lines()[-1] == "7"
    tail.close()


def test_line_between_the_last_read_and_the_renaming_is_read(tmp_path):
    path, old = tmp_path / "encoder.csv", tmp_path / "encoder.csv.1"

    class Raced(FileTail):
        def _is_replaced(self):
            path.rename(old)
            append(old, b"2\n")
            append(path, b"3\n")
            return super()._is_replaced()

    append(path, b"")
    tail = Raced(path)
    append(path, b"1\n")
    assert tail.read_lines() == ["1", "2", "3"]
    tail.close()
