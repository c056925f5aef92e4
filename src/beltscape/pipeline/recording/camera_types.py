"""Types of a project's cameras: told in project.toml, or stated by the cameras themselves."""

from __future__ import annotations

from collections.abc import Sequence

from beltscape.files.camera_types import CameraType
from beltscape.sources.genicam.access.aravis import FoundCamera
from beltscape.sources.genicam.settings import CamerasSettings


def list_camera_types(settings: CamerasSettings, found: Sequence[FoundCamera]) -> dict[str, CameraType]:
    """Return the type of every camera by name: the project's, else the camera's own (GenICam's DeviceModelName)."""
    stated = {
        key: f"{camera.maker} {camera.model}".strip()
        for camera in found
        for key in (camera.device, camera.address, camera.serial)
        if key
    }
    return {
        name: CameraType(
            settings.models.get(name) or stated.get(device, ""), settings.lens_models.get(name, "")
        )
        for name, device in settings.devices.items()
    }
