"""Settings of GenICam cameras: own, common and refused ones."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from beltscape.core.errors import InputError, SettingsError
from beltscape.files.toml_text import read_toml, validate
from beltscape.sources.genicam.matching import BeltCounter
from beltscape.sources.genicam.pixels import FORMATS
from beltscape.sources.genicam.settings import CameraEncoderSettings, CamerasSettings, PixelFormat
from beltscape.sources.genicam.source import open_cameras

TABLE = """
exposure_us = 800
gain_db = 3
pixel_format = "Mono12p"
trigger = "line"
frames_per_s = 20
[devices]
cam0 = "192.168.10.11"
cam1 = "Basler-21730563"
[own.cam1]
exposure_us = 950
pixel_format = "BayerRG8"
[encoder]
chunk = "CounterValue"
mm_per_count = 0.05
"""


def read(tmp_path, text: str) -> CamerasSettings:
    path = tmp_path / "cameras.toml"
    path.write_text(text)
    return validate(path, CamerasSettings, read_toml(path))


def test_camera_has_its_own_or_the_common_settings(tmp_path):
    settings = read(tmp_path, TABLE)
    assert (settings.exposure_of("cam0"), settings.exposure_of("cam1")) == (800, 950)
    assert (settings.format_of("cam0"), settings.format_of("cam1")) == ("Mono12p", "BayerRG8")
    assert (settings.gain_of("cam0"), settings.gain_of("cam1")) == (3, 3)
    assert settings.offset_of("cam0") == (0, 0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("exposure_us = 800", "exposure_ms = 1", "did you mean exposure_us"),
        ("[own.cam1]", "[own.cam2]", "own.cam2: no such camera in devices; there are cam0, cam1"),
        ("Basler-21730563", "192.168.10.11", "same device is given twice"),
        ("frames_per_s = 20", "frames_per_s = 300", "allowed_skew_ms 2 must be less than 1.33"),
        ('chunk = "CounterValue"', "", "either chunk or feature"),
        ("mm_per_count = 0.05", "mm_per_count = 0", "must not be 0"),
        ("gain_db = 3", "gain_db = 99", "gain_db = 99"),
        ('"Mono12p"', '"Mono13"', "pixel_format"),
    ],
)
def test_invalid_settings_are_refused_in_one_line(tmp_path, old, new, message):
    with pytest.raises(InputError) as error:
        read(tmp_path, TABLE.replace(old, new, 1))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_every_format_that_can_be_set_can_be_read():
    assert set(PixelFormat.__args__) - {one.name for one in FORMATS.values()} == set()  # pyrefly: ignore[missing-attribute]


def test_rig_camera_without_a_device_is_refused():
    pytest.importorskip("gi", reason="PyGObject is not installed")
    settings = CamerasSettings(devices={"cam0": "127.0.0.11"})
    with pytest.raises(SettingsError, match="cam1 has no device; there are cam0"):
        open_cameras(settings, "cam0", {"cam0": (4, 4), "cam1": (4, 4)})


def test_missing_aravis_is_refused_with_the_packages(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "gi", None)
    with pytest.raises(SettingsError, match=r"gir1\.2-aravis-0\.8.*pip install 'beltscape\[cameras\]'"):
        open_cameras(CamerasSettings(devices={"cam0": "127.0.0.11"}), "cam0")


@given(
    st.integers(0, 2**20), st.lists(st.integers(-100, 30000), max_size=50), st.sampled_from([0.05, 2.0, -0.1])
)
def test_position_continues_when_the_counter_wraps(start, steps, mm_per_count):
    counter = BeltCounter(CameraEncoderSettings(mm_per_count=mm_per_count, chunk="CounterValue", bits=16))
    count, begin = start, counter.position_mm(start % 65536)
    for step in steps:
        count += step
        assert counter.position_mm(count % 65536) - begin == pytest.approx((count - start) * mm_per_count)


def test_position_continues_after_a_power_loss():
    counter = BeltCounter(CameraEncoderSettings(mm_per_count=0.5, feature="Counter0Value"))
    assert counter.position_mm(10_000) == 5000
    counter.on_reopened()
    assert counter.position_mm(10_100) == 5050  # only the network was gone
    counter.on_reopened()
    assert counter.position_mm(40) == 5070  # it began at 0
    assert counter.position_mm(30) == 5065  # backwards


def test_limits_of_settings_are_enforced():
    with pytest.raises(ValidationError):
        CamerasSettings(devices={})
