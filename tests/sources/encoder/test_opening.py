"""Opening of encoders: datagrams, files and refused settings."""

from __future__ import annotations

import socket
from math import isnan
from time import monotonic, monotonic_ns, sleep

import pytest

from beltscape.core.errors import InputError
from beltscape.files.toml_text import validate
from beltscape.sources.encoder.opening import open_encoder
from beltscape.sources.encoder.settings import EncoderSettings
from tests.optional import require


def wait_until(true, seconds=5.0):
    """Whether something becomes true in time."""
    end = monotonic() + seconds
    while monotonic() < end:
        if true():
            return True
        sleep(0.002)
    return False


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]


@pytest.fixture
def udp(tmp_path):
    """A function settings → (encoder, send)."""
    opened = []

    def start(**values):
        port = free_port()
        encoder = open_encoder(EncoderSettings(kind="udp", port=port, **values), tmp_path)
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.extend((encoder, sock))
        return encoder, lambda text: sock.sendto(text.encode(), ("127.0.0.1", port))

    yield start
    for one in opened:
        one.close()  # pyrefly: ignore[missing-attribute]


def test_datagrams_are_received(udp):
    encoder, send = udp()
    assert encoder.position_at(monotonic_ns(), "f") is None
    send("100.5")
    assert wait_until(lambda: encoder.silent_s < 0.5 and encoder._track._times_ns)
    first = monotonic_ns()
    sleep(0.01)
    send("110.5\n")
    assert wait_until(lambda: encoder._track._times_ns[-1] > first)
    position = encoder.position_at(first, "f")
    assert 100.5 <= position <= 110.5
    assert encoder.trouble == ""


def test_datagrams_that_are_no_readings_are_reported(udp):
    encoder, send = udp()
    for text in ("rubbish", "", "1,2,3,4", "\x00\xff", "9" * 5000):
        try:
            send(text)
        except OSError:  # larger than the system lets through
            continue
    send("1")
    assert wait_until(lambda: bool(encoder._track._times_ns))
    assert "cannot be read" in encoder.trouble


def test_datagrams_of_other_senders_are_ignored(udp):
    encoder, send = udp(sender="127.0.0.2")
    send("1")
    assert wait_until(lambda: "127.0.0.1" in encoder.trouble)
    assert encoder.position_at(monotonic_ns(), "f") is None


def test_datagram_may_have_several_lines(udp):
    encoder, send = udp()
    send("0.00,5\n0.01,6\n0.02,7\n")
    assert wait_until(lambda: encoder._track._positions_mm == [7.0])  # their times are not known yet
    assert encoder.trouble == ""


def test_a_port_in_use_is_refused(udp, tmp_path):
    encoder, _ = udp()
    with pytest.raises(InputError, match="give a free port"):
        open_encoder(encoder._settings, tmp_path)
    with pytest.raises(InputError, match="is no address"):
        open_encoder(EncoderSettings(kind="udp", host="no-such-host.invalid"), tmp_path)


def test_growing_file_is_followed(tmp_path):
    path = tmp_path / "encoder.csv"
    path.write_text("frame,timestamp_s,belt_position_mm\nold,1.0,5\n")
    settings = EncoderSettings(kind="file", path="encoder.csv", poll_s=0.002)
    encoder = require(open_encoder(settings, tmp_path))
    try:
        with path.open("a") as file:
            for k in range(5):
                file.write(f"f{k},{100 + 0.01 * k},{1000 + 20 * k}\n")
                file.flush()
        assert wait_until(lambda: encoder.position_at(monotonic_ns(), "f4") == 1080)
        assert encoder.position_at(monotonic_ns(), "f2") == 1040
        assert encoder.position_at(monotonic_ns(), "old") is None
        path.rename(tmp_path / "encoder.csv.1")
        path.write_text("frame,timestamp_s,belt_position_mm\nf5,100.05,1100\n")
        assert wait_until(lambda: encoder.position_at(monotonic_ns(), "f5") == 1100)
        assert encoder.trouble == ""
    finally:
        encoder.close()


def test_folder_in_place_of_the_file_is_refused(tmp_path):
    encoder = require(open_encoder(EncoderSettings(kind="file", path=".", poll_s=0.002), tmp_path))
    try:
        assert wait_until(lambda: "cannot be read" in encoder.trouble)
    finally:
        encoder.close()


def test_table_of_a_capture_is_read_by_frame(tmp_path):
    (tmp_path / "encoder.csv").write_text("frame,timestamp_s,belt_position_mm\na.png,0.0,10\nb,0.1,40\n")
    encoder = require(open_encoder(EncoderSettings(kind="capture"), tmp_path / "elsewhere", capture=tmp_path))
    assert [encoder.position_at(None, name) for name in ("a", "b", "c")] == [10, 40, None]
    assert isnan(encoder.silent_s)
    named = require(open_encoder(EncoderSettings(kind="capture", path="encoder.csv"), tmp_path))
    assert named.position_at(0, "b") == 40
    with pytest.raises(InputError, match="for a replay"):
        open_encoder(EncoderSettings(kind="capture"), tmp_path)


def test_constant_speed_continues_from_the_ledgers_end(tmp_path):
    settings = EncoderSettings(kind="constant", speed_mm_s=2000)
    encoder = require(open_encoder(settings, tmp_path, resume_mm=500.0))
    assert encoder.position_at(7_000_000_000, "a") == 500
    assert encoder.position_at(7_500_000_000, "b") == 1500
    assert encoder.position_at(None, "c") is None


@pytest.mark.parametrize("kind", ["camera", "none"])
def test_kinds_without_an_encoder_open_none(tmp_path, kind):
    assert open_encoder(EncoderSettings(kind=kind), tmp_path) is None


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"kind": "file"}, "needs path"),
        ({"kind": "constant"}, "needs speed_mm_s"),
        ({"kind": "udp", "counter_bits": 24}, "counter_bits"),
        ({"kind": "udp", "prt": 5}, "did you mean port"),
        ({"kind": "upd"}, "kind = 'upd'"),
    ],
)
def test_invalid_settings_are_refused(tmp_path, values, words):
    with pytest.raises(InputError, match=words):
        validate(tmp_path / "project.toml", EncoderSettings, values)
