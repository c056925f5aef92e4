"""The part of a project that recording needs: its cameras with their types, and its encoder, before there is a rig.

Types of cameras are told in project.toml, or stated by the cameras themselves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beltscape.core.checks import is_dict
from beltscape.core.errors import InputError
from beltscape.files.camera_types import CameraType
from beltscape.files.rig_json import read_rig
from beltscape.files.toml_text import read_toml, validate
from beltscape.sources.encoder.opening import Encoder, open_encoder
from beltscape.sources.encoder.settings import EncoderSettings
from beltscape.sources.genicam.aravis import FoundCamera
from beltscape.sources.genicam.settings import CamerasSettings


@dataclass(frozen=True, slots=True)
class RecordingProject:
    """The cameras and the encoder of a project.toml."""

    path: Path
    cameras: CamerasSettings
    encoder: EncoderSettings
    core: str
    """The camera that leads: the rig's core camera if there is a rig, else the first of the table."""

    def open_encoder(self) -> Encoder | None:
        """Open the encoder; None if the core camera counts it, or there is none."""
        return open_encoder(self.encoder, self.path.parent)


def read_recording_project(path: Path) -> RecordingProject:
    """Read the tables [cameras] and [encoder] of a project.toml; no other table is needed.

    Raises
    ------
    InputError, SettingsError
        with the first value that does not fit.
    """
    values = read_toml(path)
    cameras = read_cameras(path, values)
    encoder = (
        validate(path, EncoderSettings, values["encoder"])
        if is_dict(values.get("encoder"))
        else EncoderSettings()
    )
    return RecordingProject(path, cameras, encoder, _find_core(path, values, cameras))


def read_cameras(path: Path, values: Mapping[str, Any]) -> CamerasSettings:
    """Return the settings of the table [cameras]; InputError if it is missing or invalid."""
    table = values.get("cameras")
    if not is_dict(table):
        raise InputError(
            f"{path}: it has no table [cameras]; name the cameras in it: devices = {{ cam0 = … }}"
        )
    return validate(path, CamerasSettings, table)


def _find_core(path: Path, values: Mapping[str, Any], cameras: CamerasSettings) -> str:
    rig = values.get("rig")
    place = path.parent / rig if isinstance(rig, str) else None
    if place is not None and place.is_file():
        core = read_rig(place).core
        if core in cameras.devices:
            return core
    return next(iter(cameras.devices))


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
