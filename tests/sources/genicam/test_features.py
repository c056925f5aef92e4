"""Settings applied to a camera, recorded by a camera that stores its calls."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from beltscape.core.errors import InputError
from beltscape.sources.genicam.device import Features
from beltscape.sources.genicam.settings import CamerasSettings

LIB = SimpleNamespace(
    Auto=SimpleNamespace(OFF="off"), AcquisitionMode=SimpleNamespace(CONTINUOUS="continuous")
)


class Notebook:
    """A camera of 640×480 px that has what it is given."""

    def __init__(self, features=("TriggerActivation", "PtpEnable")) -> None:
        self.features = features
        self.calls: dict[str, tuple] = {}

    def __getattr__(self, call: str):
        answers = {
            "dup_available_pixel_formats_as_strings": ["Mono8", "Mono12p"],
            "dup_available_trigger_sources": ["Line1", "Software"],
            "get_sensor_size": SimpleNamespace(width=640, height=480),
            "get_region": (0, 0, 640, 480),
            "get_exposure_time_bounds": (10.0, 5000.0),
            "get_gain_bounds": (0.0, 24.0),
        }

        def called(*values):
            if call == "is_feature_available":
                return values[0] in self.features
            if call in answers:
                return answers[call]
            if call.startswith("is_"):
                return True
            self.calls[f"{call} {values[0]}" if call in ("set_boolean", "set_string") else call] = values
            return None

        return called


def apply(camera: Notebook, size_px=(640, 480), **more) -> dict[str, tuple]:
    settings = CamerasSettings.model_validate({"devices": {"cam0": "10.0.0.1"}, **more})
    Features(LIB, "cam0", camera).apply(settings, size_px)
    return camera.calls


def test_line_trigger_exposure_network_and_shared_clock_are_set():
    calls = apply(
        Notebook(),
        trigger="line",
        trigger_activation="FallingEdge",
        exposure_us=700,
        gain_db=3,
        pixel_format="Mono12p",
        clocks="ptp",
        packet_size=8000,
        packet_delay_ns=5000,
    )
    assert calls == {
        "set_pixel_format_from_string": ("Mono12p",),
        "set_exposure_time_auto": ("off",),
        "set_exposure_time": (700,),
        "set_gain_auto": ("off",),
        "set_gain": (3,),
        "set_acquisition_mode": ("continuous",),
        "set_trigger": ("Line1",),
        "set_string TriggerActivation": ("TriggerActivation", "FallingEdge"),
        "set_boolean PtpEnable": ("PtpEnable", True),
        "gv_set_packet_size": (8000,),
        "gv_set_packet_delay": (5000,),
    }


def test_settings_not_given_are_not_changed():
    calls = apply(Notebook(features=("GevIEEE1588",)), clocks="ptp", trigger="free", frames_per_s=20)
    assert calls == {
        "set_pixel_format_from_string": ("Mono8",),
        "set_acquisition_mode": ("continuous",),
        "clear_triggers": (),
        "set_frame_rate": (20,),
        "set_boolean GevIEEE1588": ("GevIEEE1588", True),
        "gv_auto_packet_size": (),
    }


def test_part_of_the_sensor_is_set():
    calls = apply(Notebook(), (320, 200), own={"cam0": {"offset_px": [16, 8]}})
    assert calls["set_region"] == (16, 8, 320, 200)


@pytest.mark.parametrize(
    ("size_px", "more", "message"),
    [
        ((640, 480), {"pixel_format": "RGB8"}, "offers no RGB8; it has Mono12p, Mono8"),
        (
            (640, 480),
            {"trigger": "line", "trigger_line": "Line7"},
            "no trigger input Line7; there are Line1, Software",
        ),
        ((640, 480), {"exposure_us": 9000}, "exposure_us 9000 is outside the camera's 10 to 5000"),
        ((640, 480), {"gain_db": -1}, "gain_db -1 is outside the camera's 0 to 24"),
        ((640, 500), {}, "640×500 px from 0, 0 on do not fit on the sensor's 640×480"),
    ],
)
def test_unsupported_setting_is_refused(size_px, more, message):
    with pytest.raises(InputError, match="cam0: ") as error:
        apply(Notebook(), size_px, **more)
    assert message in str(error.value)


def test_a_missing_feature_names_the_setting():
    with pytest.raises(
        InputError, match=r"cam0: the camera has no feature Counter9; correct encoder\.feature"
    ):
        Features(LIB, "cam0", Notebook()).require_feature("Counter9", "encoder.feature")


@pytest.mark.parametrize(
    ("missing", "setting", "named"),
    [
        ("is_exposure_time_available", {"exposure_us": 500}, "no feature for its exposure time; leave exposure_us"),
        ("is_gain_available", {"gain_db": 3}, "no feature for its gain; leave gain_db"),
    ],
)  # fmt: skip
def test_a_missing_control_is_named_with_the_setting_that_asks_for_it(missing, setting, named):
    camera = Notebook()
    setattr(camera, missing, lambda: False)
    with pytest.raises(InputError, match=named):
        apply(camera, **setting)
    assert apply(camera)  # nothing asks for it


def test_what_the_camera_states_is_read_back():
    camera = Notebook()
    setattr(camera, "get_exposure_time", lambda: 498.7)  # noqa: B010
    setattr(camera, "is_gain_available", lambda: False)  # noqa: B010
    applied = Features(LIB, "cam0", camera).read_back()
    assert (applied.exposure_us, applied.gain_db) == (498.7, None)
