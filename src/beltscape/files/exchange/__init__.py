"""Exchange of rigs with OpenCV, Kalibr, COLMAP, ROS, VIC-3D, MC-Calib and caliscope, each format in a module.

Every format shares OpenCV's camera axes (x right, y down, z forward) and lens models; they differ in units,
in the direction and the reference of their transforms and in the position of pixel (0, 0). Each module's
docstring defines its format (`opencv_yaml`, `opencv_stereo`, `kalibr`, `colmap`, `ros`, `vic3d`, `mc_calib`,
`caliscope`); a warning with figures reports what a format cannot hold. All read a `rig_description` from
`documents` by checked `values`.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from beltscape.core.checks import is_dict
from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.files.paths import AnyPath, as_path

if TYPE_CHECKING:
    from beltscape.core.geometry.camera import Camera
    from beltscape.core.geometry.rig import Rig
    from beltscape.core.progress import Reporter
    from beltscape.files.exchange.rig_description import RigDescription


@dataclass(frozen=True, slots=True)
class RigFormat:
    """A format of another program."""

    module: str
    """Its module in this package, imported only when it is needed."""
    example: str = ""
    """An example of what is written; empty: the format is only read."""
    is_folder: bool = False
    """Whether a folder is written."""


READABLE: Mapping[str, RigFormat] = {
    "opencv": RigFormat("opencv_yaml", "rig.yaml"),
    "kalibr": RigFormat("kalibr", "camchain.yaml"),
    "colmap": RigFormat("colmap", "rig_config.json"),
    "ros": RigFormat("ros", "camera_info", is_folder=True),
    "vic3d": RigFormat("vic3d"),
    "opencv-stereo": RigFormat("opencv_stereo"),
    "mc-calib": RigFormat("mc_calib"),
    "caliscope": RigFormat("caliscope"),
}
"""All formats by their names."""

FORMATS = {name: one for name, one in READABLE.items() if one.example}
"""Those that are also written."""

RIG_JSON = "rig.json"
"""Name that `detect_format` gives to Beltscape's own format."""


class ExchangeFormat(Protocol):
    """The interface of a format's module."""

    def is_of_format(self, document: Any) -> bool:
        """Return whether a parsed YAML, JSON or XML file has this format."""
        ...

    def read(self, path: Path, warn: Callable[[str], None]) -> RigDescription:
        """Read a file or folder; ValueError with a readable message if it is invalid."""
        ...

    def write(self, path: Path, rig: Rig, warn: Callable[[str], None]) -> list[Path]:
        """Write the rig, atomically; return the files written."""
        ...


def export_rig(path: AnyPath, rig: Rig, kind: str, reporter: Reporter) -> list[Path]:
    """Write ``rig`` at ``path`` in the format ``kind``; warn of what the format cannot hold."""
    path = as_path(path)
    limited = {
        name: f"{c.valid_radius_px:.0f}" for name, c in rig.cameras.items() if c.valid_radius_px is not None
    }
    if limited:
        texts = (f"{name} up to {radius} px" for name, radius in limited.items())
        reporter.warn(
            f"{path}: lenses were calibrated for a part of the image ({', '.join(texts)} from the principal point); "
            "only rig.json holds that"
        )
    if kind in READABLE and kind not in FORMATS:
        raise InputError(f"format {kind!r} is read, not written; there are {', '.join(FORMATS)}")
    with _errors_of(path):
        return _module(kind).write(path, rig, lambda text: reporter.warn(f"{path}: {text}"))


def import_rig(
    path: AnyPath, reporter: Reporter, *, kind: str | None = None, core: str | None = None
) -> tuple[Rig, str]:
    """Read a rig and its format from ``path``, relative to camera ``core`` or to the file's reference."""
    path = as_path(path)
    kind = kind or detect_format(path)
    if kind == RIG_JSON:
        raise InputError(f"{path}: is a rig.json of Beltscape already; use it as it is")
    with _errors_of(path):
        return _read(path, kind, reporter).rig(core), kind


def read_intrinsics(
    path: AnyPath, reporter: Reporter | None = None, *, kind: str | None = None
) -> dict[str, Camera]:
    """Read cameras by name from rig.json or any of the formats; poses are not needed."""
    path = as_path(path)
    kind = kind or detect_format(path)
    if kind == RIG_JSON:
        from beltscape.files.rig_json import read_rig

        return dict(read_rig(path).cameras)
    with _errors_of(path):
        return dict(_read(path, kind, reporter or Silent()).cameras)


def detect_format(path: Path) -> str:
    """Return the name of the format of a file or folder; InputError unless exactly one fits."""
    from beltscape.files.exchange.documents import read_document, yaml_files

    documents = [read_document(file) for file in (yaml_files(path) if path.is_dir() else [path])]
    if any(is_dict(d) and str(d.get("format")).startswith("beltscape-rig/") for d in documents):
        return RIG_JSON
    names = [name for name in READABLE if any(_module(name).is_of_format(d) for d in documents)]
    if len(names) != 1:
        what = f"could be {' or '.join(names)}" if names else f"is none of {', '.join(READABLE)}"
        raise InputError(f"{path}: {what}; give a calibration file, or its --format")
    return names[0]


def _read(path: Path, kind: str, reporter: Reporter) -> RigDescription:
    return _module(kind).read(path, lambda text: reporter.warn(f"{path}: {text}"))


def _module(kind: str) -> ExchangeFormat:
    if kind not in READABLE:
        raise InputError(f"format {kind!r} is not known; there are {', '.join(READABLE)}")
    return import_module(f"{__name__}.{READABLE[kind].module}")  # pyrefly: ignore[bad-return]


@contextmanager
def _errors_of(path: Path) -> Generator[None]:
    """Turn a ValueError into an InputError that names the file."""
    try:
        yield
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
