"""The opening of a camera: in which order it is prepared."""

from __future__ import annotations

from unittest.mock import MagicMock

import pytest

from beltscape.sources.genicam import device
from beltscape.sources.genicam.settings import CamerasSettings


def test_a_camera_that_a_killed_program_left_sending_is_stopped_before_it_is_set(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Else its settings may be locked, and its images go to the dead program's port."""
    lib, camera = MagicMock(), MagicMock()
    lib.Camera.new.return_value = camera
    camera.dup_available_pixel_formats_as_strings.return_value = ["Mono8"]
    camera.dup_available_trigger_sources.return_value = ["Software"]
    camera.get_payload.return_value = 100
    camera.stop_acquisition.side_effect = RuntimeError("was not sending")
    monkeypatch.setattr(device, "load_aravis", lambda: lib)
    monkeypatch.setattr(device, "glib_error_type", lambda: RuntimeError)
    settings = CamerasSettings(devices={"cam0": "127.0.0.11"})
    device.Device("cam0", settings, None, has_encoder=False)
    calls = [name for name, _, _ in camera.mock_calls]
    places = [
        calls.index(name)
        for name in ("stop_acquisition", "set_pixel_format_from_string", "start_acquisition")
    ]
    assert places == sorted(places)
