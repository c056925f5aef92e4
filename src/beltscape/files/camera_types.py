"""Types of a capture's cameras, ``cameras.json``: the maker's model, and the lens model where it is known.

``beltscape record`` writes it into a capture from the cameras themselves and from project.toml; it may be written by
hand. Cameras of one type have like lenses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.checks import is_dict
from beltscape.core.errors import InputError
from beltscape.core.geometry.lens import MODELS
from beltscape.files.json_text import read_json, write_json

FORMAT = "beltscape-cameras/1"
FILE_NAME = "cameras.json"


@dataclass(frozen=True, slots=True)
class CameraType:
    """Properties of a camera that are known without images."""

    model: str = ""
    """The maker's name of the camera, and of its lens if cameras of one name have several; empty: unknown."""
    lens_model: str = ""
    """One of `core.geometry.lens.MODELS`; empty: unknown."""


def read_camera_types(capture: Path) -> dict[str, CameraType]:
    """Return the types of the cameras of a capture folder, by name; none without a cameras.json.

    Raises
    ------
    InputError
        With the key that is wrong.
    """
    path = capture / FILE_NAME
    if not path.is_file():
        return {}
    document = read_json(path)
    if not is_dict(document) or document.get("format") != FORMAT:
        raise InputError(f'{path}: format must be "{FORMAT}"')
    cameras = document.get("cameras")
    if not is_dict(cameras):
        raise InputError(f"{path}: cameras must be a table of cameras by name")
    return {str(name): _parse_type(path, str(name), entry) for name, entry in cameras.items()}


def write_camera_types(capture: Path, types: Mapping[str, CameraType]) -> Path:
    """Write the types of the cameras of a capture folder; return the path."""
    cameras = {
        name: {key: value for key, value in (("model", t.model), ("lens_model", t.lens_model)) if value}
        for name, t in types.items()
    }
    write_json(capture / FILE_NAME, {"format": FORMAT, "cameras": cameras})
    return capture / FILE_NAME


def _parse_type(path: Path, name: str, entry: object) -> CameraType:
    if not is_dict(entry):
        raise InputError(f"{path}: cameras.{name} must be a table with model or lens_model")
    for key, value in entry.items():
        if key not in ("model", "lens_model") or not isinstance(value, str):
            raise InputError(
                f"{path}: cameras.{name}.{key} = {value!r}: only model and lens_model, as text, are known"
            )
    lens = entry.get("lens_model", "")
    if lens and lens not in MODELS:
        raise InputError(f"{path}: cameras.{name}.lens_model = {lens!r}: must be one of {', '.join(MODELS)}")
    return CameraType(entry.get("model", ""), lens)
