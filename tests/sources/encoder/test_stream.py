"""Encoder readings as lines of text."""

from __future__ import annotations

import json
from time import monotonic_ns

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.sources.encoder.readings import EncoderOffset, ReadingStream, parse_reading
from beltscape.sources.encoder.settings import EncoderSettings
from tests.files.damages import DAMAGES, check_set_aside, damage_values
from tests.strategies import floats

SETTINGS = EncoderSettings(kind="udp", wait_s=0)
MS = 1_000_000


@given(floats(-1e12, 1e12), floats(-1e9, 1e9))
def test_a_reading_is_read_as_it_was_written(position, stamp):
    for line, stamp_ns, frame in (
        (f"{position!r}", None, ""),
        (f" {stamp!r} , {position!r} \r", round(stamp * 1e9), ""),
        (f"f7,{stamp!r},{position!r}", round(stamp * 1e9), "f7"),
        (f"f7.png,{stamp!r},{position!r}", round(stamp * 1e9), "f7"),
    ):
        reading = parse_reading(line)
        assert reading is not None
        assert (reading.count, reading.stamp_ns, reading.frame) == (position, stamp_ns, frame)


@pytest.mark.parametrize(
    "line", ["", "  ", "frame,timestamp_s,belt_position_mm", "timestamp_s,belt_position_mm"]
)
def test_headers_and_empty_lines_are_no_readings(line):
    assert parse_reading(line) is None


@pytest.mark.parametrize(
    "line", ["nan", "inf", "1e16", "1,2,3,4", "a", "1;2", "1,", ",1,", "0" * 300, "1,x,2"]
)
def test_other_text_is_refused(line):
    with pytest.raises(ValueError, match=r"."):
        parse_reading(line)


@pytest.mark.parametrize(
    "lines", [["149,0"], ["149,0", "149,5", "150,25"], ["-3,5"], ["f1,149,0"], ["149,0", "149.5"]]
)
def test_a_decimal_comma_is_no_timestamp(lines):
    stream, now = ReadingStream(SETTINGS), monotonic_ns()
    for line in lines:
        stream.add_line(line, now)
    assert "a decimal comma? send " in stream.trouble
    assert stream.position_at(now, "") == (149.5 if "149.5" in lines else None)


def test_whole_timestamps_are_read_after_one_with_a_decimal_point():
    stream, now = ReadingStream(SETTINGS), monotonic_ns()
    for line in ("0,0", "11.98,3360", "12,3400", "f9,12,3440"):  # as C's %g writes them
        stream.add_line(line, now)
    assert stream.trouble == ""
    assert stream.position_at(None, "f9") == 3440


@pytest.mark.parametrize("times", ["device", "steady"])
@pytest.mark.parametrize(
    ("factor", "unit"), [(1, ""), (1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")]
)
def test_timestamps_in_another_unit_are_reported(times, factor, unit):
    stream, now = ReadingStream(EncoderSettings(kind="udp", wait_s=0, times=times)), monotonic_ns()
    for k in range(30):
        delay_ms = 900 if k == 20 else 0  # a burst after a delay is no other unit
        stream.add_line(f"{5.25 + 0.1 * k * factor:.3f},{200 * k}", now + (100 * k + delay_ms) * MS)
    assert stream.trouble.count("as fast as this machine's clock; in") == (unit != "")
    assert unit in stream.trouble


@given(st.text(max_size=400))
def test_any_text_is_parsed_or_refused(line):
    stream = ReadingStream(SETTINGS)
    stream.add_line("1.0", 10)
    stream.add_line(line, 20)
    assert isinstance(stream.trouble, str)
    assert "\n" not in stream.trouble


def test_positions_are_interpolated_between_arrivals():
    stream = ReadingStream(SETTINGS)
    for k in range(5):
        stream.add_line(f"{100 + 10 * k}", k * 10 * MS)
    assert stream.position_at(25 * MS, "f") == pytest.approx(125)
    assert stream.position_at(None, "f") is None


def test_device_times_are_converted_to_this_machines():
    stream = ReadingStream(SETTINGS)
    for k, delay in enumerate((3, 0, 5, 9, 2)):
        stream.add_line(f"{1.7e9 + 0.01 * k:.6f},{20 * k}", (1000 + 10 * k + delay) * MS)
    assert stream.position_at(1035 * MS, "f") == pytest.approx(70, abs=0.01)


def test_device_times_may_be_ignored():
    stream = ReadingStream(EncoderSettings(kind="udp", wait_s=0, times="arrival"))
    for k, delay in enumerate((3, 0, 5)):
        stream.add_line(f"{1.7e9 + 0.01 * k:.6f},{20 * k}", (1000 + 10 * k + delay) * MS)
    assert stream.position_at(1010 * MS, "f") == 20


def test_steady_times_are_this_machines_own():
    stream = ReadingStream(EncoderSettings(kind="file", path="x", wait_s=0, times="steady"))
    for k in range(3):
        stream.add_line(f"{5 + 0.01 * k:.3f},{20 * k}", 6_000 * MS)
    assert stream.position_at(5_010 * MS, "f") == 20


def test_a_named_frame_has_its_own_reading():
    stream = ReadingStream(SETTINGS)
    stream.add_line("f1.png,0.0,50", 0)
    stream.add_line("f2,0.1,60", 100 * MS)
    assert stream.position_at(77 * MS, "f1") == 50
    assert stream.position_at(None, "f2") == 60
    # a name that comes again much later is not that frame
    assert stream.position_at(3_600_000 * MS, "f1") is None


def test_faults_are_reported():
    stream = ReadingStream(SETTINGS)
    assert stream.trouble == ""
    now = monotonic_ns()
    stream.add_line("rubbish", now)
    assert "rubbish" in stream.trouble
    backwards = ReadingStream(SETTINGS)
    for k in range(20):
        backwards.add_line(f"{-100 * k}", now + k * 20 * MS)
    assert "backwards by 1900 mm" in backwards.trouble
    jumped = ReadingStream(SETTINGS)
    for position in (5e6, 5e6 + 1, 7.0):
        jumped.add_line(f"{position}", now)
    assert "jumped" in jumped.trouble


def test_silence_increases_and_ends():
    stream = ReadingStream(SETTINGS)
    now = monotonic_ns()
    stream.add_line("1", now - 5_000 * MS)
    assert 5 <= stream.silent_s < 6
    stream.add_line("nonsense", now)
    assert stream.silent_s >= 5
    stream.add_line("2", monotonic_ns())
    assert stream.silent_s < 1


def test_count_continues_over_a_reset_and_a_restart(tmp_path):
    """Device: 900 m, reset, 40 m; the program is restarted at 40 m and at 60 m."""
    offset = EncoderOffset(tmp_path / "encoder.json", SETTINGS)
    first = ReadingStream(SETTINGS, offset)
    first.add_line("900000", 0)
    first.add_line("0", 10 * MS)
    for k in range(1, 41):
        first.add_line(f"{1000 * k}", 10 * MS + k * 1000 * MS)
    end = first.position_at(40_010 * MS, "f")
    assert end == 940_000
    second = ReadingStream(SETTINGS, EncoderOffset(tmp_path / "encoder.json", SETTINGS), resume_mm=end)
    second.add_line("60000", 5)
    assert second.position_at(5, "f") == 960_000
    assert second.trouble == ""


def test_a_damaged_offset_is_set_aside_and_reported(tmp_path):
    path = tmp_path / "encoder.json"

    def read():
        return [ReadingStream(SETTINGS, EncoderOffset(path, SETTINGS)).trouble]

    assert EncoderOffset(path, SETTINGS).write_mm(12.5) == ""
    wrong = [data for key, data in damage_values(path).items() if key.startswith("offset_mm")]
    assert len(wrong) == 6
    for data in (*DAMAGES.values(), *wrong):
        check_set_aside(path, data, read)
    stream = ReadingStream(SETTINGS, EncoderOffset(path, SETTINGS), 50_000.0)
    stream.add_line("3", 10**9)
    assert stream.position_at(10**9, "") == 50_000.0  # positions go on at the ledger's end


def test_offset_belongs_to_its_encoder(tmp_path):
    path = tmp_path / "encoder.json"
    assert EncoderOffset(path, SETTINGS).write_mm(12.5) == ""
    assert json.loads(path.read_text())["format"] == "beltscape-encoder/1"
    assert EncoderOffset(path, SETTINGS).read_mm() == 12.5
    assert EncoderOffset(path, EncoderSettings(kind="udp", mm_per_count=0.5)).read_mm() == 0


def test_offset_that_cannot_be_written_is_reported(tmp_path):
    (tmp_path / "data").write_text("a file in the way")
    stream = ReadingStream(SETTINGS, EncoderOffset(tmp_path / "data" / "encoder.json", SETTINGS))
    now = monotonic_ns()
    for line in ("900000", "0"):
        stream.add_line(line, now)
    assert any("cannot be written" in text for _, text in stream._notices.values())
