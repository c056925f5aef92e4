"""Inspection of a camera: its size, pixel formats and triggers, and whether it accepts the settings."""

from __future__ import annotations

from dataclasses import dataclass

from beltscape.core.errors import InputError
from beltscape.sources.genicam.access.aravis import glib_error_type, load_aravis
from beltscape.sources.genicam.access.device import Device
from beltscape.sources.genicam.settings import CamerasSettings


@dataclass(frozen=True, slots=True)
class Inspection:
    """The abilities of a camera."""

    size_px: tuple[int, int]
    """Width and height of its sensor."""
    formats: tuple[str, ...]
    """Pixel formats it offers."""
    triggers: tuple[str, ...]
    """Trigger inputs of the camera."""
    trouble: str = ""
    """Why it could not be inspected; empty if it could."""


def inspect_camera(device: str) -> Inspection:
    """Open a camera by its id and read its abilities; if it cannot be opened, ``trouble`` has the reason."""
    lib = load_aravis()
    try:
        camera = lib.Camera.new(device)
        sensor = camera.get_sensor_size()
        return Inspection(
            (sensor.width, sensor.height),
            tuple(sorted(camera.dup_available_pixel_formats_as_strings() or [])),
            tuple(sorted(camera.dup_available_trigger_sources() or [])),
        )
    except glib_error_type() as error:
        return Inspection((0, 0), (), (), f"{error.message}; does another program have it open?")


def find_unreachable(settings: CamerasSettings) -> str:
    """Return which cameras cannot be opened with their settings now, and why; empty if all can."""
    troubles = {name: check_settings(name, settings) for name in settings.devices}
    return "; ".join(f"{name}: {trouble}" for name, trouble in troubles.items() if trouble)


def check_settings(name: str, settings: CamerasSettings) -> str:
    """Open a camera with its settings; return the setting that it refuses, empty if it accepts all."""
    try:
        Device(name, settings, None, has_encoder=False).close()
    except InputError as error:
        return str(error)
    return ""
