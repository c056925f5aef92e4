"""Parsing of YAML (as OpenCV, Kalibr and ROS write it), JSON and XML documents; writing of YAML."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import yaml

from beltscape.core.errors import InputError
from beltscape.files.atomic import write_text
from beltscape.files.json_text import read_json, to_plain
from beltscape.files.paths import named_read_errors
from beltscape.files.toml_text import read_toml

OPENCV_MATRIX = "tag:yaml.org,2002:opencv-matrix"


class Matrix(dict[str, Any]):
    """``{rows, cols, dt, data}``, written with OpenCV's tag ``!!opencv-matrix``."""


class Quoted(str):
    """Text written in double quotes, which every YAML reader accepts, including OpenCV's."""

    __slots__ = ()


class _Loader(yaml.SafeLoader):
    """Safe loader that reads OpenCV's matrices as plain tables."""


class _Dumper(yaml.SafeDumper):
    """Safe dumper that indents lists below their key, as OpenCV's parser requires."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:  # noqa: ARG002
        """Always indent."""
        super().increase_indent(flow, False)


_Loader.add_constructor(OPENCV_MATRIX, lambda loader, node: loader.construct_mapping(node, deep=True))
_Dumper.add_representer(Matrix, lambda dumper, m: dumper.represent_mapping(OPENCV_MATRIX, dict(m)))
_Dumper.add_representer(
    Quoted, lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", text, style='"')
)


def read_document(path: Path) -> Any:
    """Parse a YAML, JSON or TOML file, or an XML file to its root element; InputError with an error's position."""
    with named_read_errors(path, "give a rig.json or a calibration in YAML, JSON or XML"):
        data = path.read_bytes()
        if data.startswith(b"<?xml"):
            return _xml(path, data)
        text = data.decode("utf-8-sig")
    if path.suffix.lower() == ".toml":
        return read_toml(path)
    if path.suffix.lower() == ".json" and text.lstrip()[:1] in ("{", "["):
        return read_json(path)
    if text.startswith("%YAML:"):  # OpenCV before 5 writes a colon that is not valid YAML
        text = "#" + text
    try:
        return yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise InputError(f"{path}: not YAML ({where}{problem})") from error


def _xml(path: Path, data: bytes) -> ElementTree.Element:
    """Return the root element; the document declares its encoding."""
    try:
        return ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: not XML ({error})") from error


def write_yaml(path: Path, document: Mapping[str, Any], head: str = "") -> None:
    """Write a document, atomically: keys in their order, lists of numbers on one line, floats to the last digit."""
    body = yaml.dump(
        document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, default_flow_style=None, width=10**9
    )
    write_text(path, head + body)


def to_floats(values: Any) -> list[Any]:
    """Convert an array to nested lists of floats."""
    return to_plain(values)


def yaml_files(folder: Path) -> list[Path]:
    """Return the YAML files of a folder, sorted by name; InputError if there is none."""
    files = sorted(f for f in folder.iterdir() if f.suffix.lower() in (".yaml", ".yml") and f.is_file())
    files = [file for file in files if not file.name.startswith(".")]
    if not files:
        raise InputError(f"{folder}: holds no .yaml file; give a folder with one calibration per camera")
    return files
