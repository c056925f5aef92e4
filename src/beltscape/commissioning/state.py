"""State of a commissioning: `commission.json` in its folder, and the settings that the engineer gives.

The file is small and written atomically; results are the files that the commands leave. A step is finished while
these exist and what it was made from is unchanged.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from time import time_ns
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from beltscape.core.checks import is_dict, is_list_or_tuple
from beltscape.core.errors import InputError, SettingsError
from beltscape.core.quantities import (
    BELT_LENGTH,
    DENSITY,
    DENSITY_SIGMA,
    EXPOSURE,
    FRAME_RATE,
    LOAD_HEIGHT,
    MOISTURE,
)
from beltscape.core.system_calls import lock_folder
from beltscape.files.atomic import write_text
from beltscape.files.json_text import hash_file, read_json, to_json
from beltscape.files.toml_text import describe_fault
from beltscape.sources.encoder.settings import EncoderSettings
from beltscape.sources.genicam.settings import CameraEncoderSettings

FILE = "commission.json"
"""Name of the file in the commissioning's folder."""
FORMAT = "beltscape-commission/1"
TOLERANCE_MM = 0.1
"""σ of depth from calibration that is enough where nothing else is stated: 0.1 % of a load of 100 mm. Chosen."""
SKEW_LIMIT_MS = 0.1
"""Largest delay of a camera where nothing else is stated: the limit at which the running plant raises an alarm."""
_MOMENTS = ("begin", "end")
_Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[^/\\\x00-\x1f]+$")]
_Line = Annotated[str, Field(max_length=120, pattern=r"^[^\x00-\x1f]*$")]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class BoardAnswer(_Table):
    """The calibration board: a file that describes it, or a ChArUco board to print."""

    file: Path | None = None
    """An existing board.toml; it goes before the keys below."""
    squares: tuple[Annotated[int, Field(ge=3, le=60)], Annotated[int, Field(ge=3, le=60)]] = (12, 9)
    square_mm: Annotated[float, Field(gt=0, le=500)] = 30.0
    marker_mm: Annotated[float, Field(gt=0, le=500)] = 22.0
    dictionary: _Name = "DICT_5X5_100"


class ReferenceAnswer(_Table):
    """The scale of the material test, or where known volumes come from."""

    name: _Line = ""
    certificate: _Line = ""
    sigma_percent: Annotated[float, Field(gt=0, le=20)] = 0.1


class MeasuredAnswer(_Table):
    """Where something was measured: a capture, or a period of the plant's own records."""

    capture: Path | None = None
    begin: AwareDatetime | None = None
    end: AwareDatetime | None = None
    """Moments of the system clock; ``now`` is the present one."""

    @model_validator(mode="after")
    def _check_order(self) -> MeasuredAnswer:
        if self.begin is not None and self.end is not None and self.begin >= self.end:
            raise ValueError("begin must be before end")
        if self.capture is not None and (self.begin or self.end):
            raise ValueError("give either a capture, or begin and end in the plant's records")
        return self


class ZeroAnswer(MeasuredAnswer):
    """The zero test: the empty belt over whole turns."""

    revolutions: Annotated[int, Field(ge=1, le=1000)] = 3
    belt_length_m: Annotated[float, BELT_LENGTH] | None = None
    """Length of the endless belt."""


class RunAnswer(MeasuredAnswer):
    """A run of the material test: where it was measured, and what is known of its load."""

    load: Annotated[str, Field(min_length=1, max_length=40)]
    mass_kg: Annotated[float, Field(gt=0, lt=1e9)] | None = None
    volume_m3: Annotated[float, Field(gt=0, lt=1e6)] | None = None
    ticket: _Line = ""


class SampleAnswer(_Table):
    """Samples that were weighed and dried apart from the belt; they tell span factor and bulk density apart."""

    density_kg_m3: Annotated[float, DENSITY] | None = None
    density_sigma_kg_m3: Annotated[float, DENSITY_SIGMA, Field(gt=0)] | None = None
    moisture_percent: Annotated[float, MOISTURE, Field(lt=95)] | None = None
    moisture_sigma_percent: Annotated[float, Field(gt=0, le=20)] | None = None

    @model_validator(mode="after")
    def _check_sigmas(self) -> SampleAnswer:
        for value, sigma, name in (
            (self.density_kg_m3, self.density_sigma_kg_m3, "density_sigma_kg_m3"),
            (self.moisture_percent, self.moisture_sigma_percent, "moisture_sigma_percent"),
        ):
            if (value is None) != (sigma is None):
                raise ValueError(f"give a sample with its σ, {name}; no sample is known exactly")
        return self


def _check_as(model: type[BaseModel]) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """Return a validator of a table that the running plant reads; it stays as it was given."""

    def check(values: dict[str, Any]) -> dict[str, Any]:
        try:
            if values:
                model(**values)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(map(str, first["loc"]))
            raise ValueError(f"{key}: {describe_fault(first)}" if key else describe_fault(first)) from error
        return values

    return check


class CommissionSettings(_Table):
    """What the engineer answers; the page's forms and ``--set`` change the same."""

    source: Literal["trial", "captures", "cameras"] | None = None
    """The shipped captures as a trial plant, a folder of recorded captures, or cameras on the network."""
    captures: Path | None = None
    """Folder of captures: ``calibration``, ``empty`` and ``moving`` below it."""
    devices: dict[_Name, _Name] = {}
    """Camera → device id, address or serial number."""
    core: str = ""
    """The core camera; empty: the first one."""
    exposure_us: Annotated[float, EXPOSURE] | None = None
    gain_db: Annotated[float, Field(ge=-24, le=60)] | None = None
    trigger: Literal["software", "line", "free"] = "software"
    frames_per_s: Annotated[float, FRAME_RATE] = 10.0
    allowed_skew_ms: Annotated[float, Field(gt=0, le=100)] = 2.0
    packet_size: Annotated[int, Field(ge=576, le=65535)] | None = None
    instants: Annotated[int, Field(ge=5, le=10_000)] = 50
    """Trigger instants that the proof of the trigger looks at."""
    belt_mm_s: Annotated[float, Field(gt=0, le=20_000)] = 2000.0
    """Greatest speed of the belt, at which the cameras' skew is given in mm of belt."""
    skew_limit_ms: Annotated[float, Field(gt=0, le=100)] = SKEW_LIMIT_MS
    """Largest delay of a camera that passes."""
    board: BoardAnswer = BoardAnswer()
    plan: Path | None = None
    """plan.toml of the belt: what the board must reach."""
    tolerance_mm: Annotated[float, Field(gt=0, le=100)] = TOLERANCE_MM
    """σ of depth from calibration that is enough."""
    accept_doubts: bool = False
    """Go on with a rig whose report has doubts."""
    seconds: Annotated[float, Field(gt=0, le=3600)] = 5.0
    """Length of the recordings of the empty belt and of the live test."""
    plant: Annotated[str, Field(min_length=1, max_length=60)] = "belt"
    load_mm: Annotated[float, LOAD_HEIGHT] = 400.0
    density_kg_m3: Annotated[float, DENSITY] | None = None
    encoder: Annotated[dict[str, Any], AfterValidator(_check_as(EncoderSettings))] = {}
    """The table [encoder] of project.toml; empty: a capture's own, or none."""
    camera_encoder: Annotated[dict[str, Any], AfterValidator(_check_as(CameraEncoderSettings))] = {}
    """The table [cameras.encoder], for an encoder that the core camera counts."""
    operator: _Line = ""
    reference: ReferenceAnswer = ReferenceAnswer()
    samples: SampleAnswer = SampleAnswer()
    zero: ZeroAnswer = ZeroAnswer()
    runs: Annotated[tuple[RunAnswer, ...], Field(max_length=100)] = ()
    material_test: Path | None = None
    """A material test's file that is there; it goes before ``runs``."""


def identify_cameras(settings: CommissionSettings) -> dict[str, Any]:
    """Return what tells one set of cameras from another, for JSON; a camera with a new address is the same one."""
    captures = str(settings.captures) if settings.source == "captures" else ""
    names = sorted(settings.devices) if settings.source == "cameras" else []
    return {"source": settings.source or "", "captures": captures, "names": names}


class CommissionState:
    """The state of a commissioning in its folder; every change is on the disk when the call returns."""

    def __init__(self, folder: Path) -> None:
        """Read ``commission.json`` if it is there; InputError where it is damaged."""
        self.folder = folder
        self.path = folder / FILE
        self._seen_ns = -1
        self._document: dict[str, Any] = {}
        self.settings = CommissionSettings()
        self.refresh()

    def refresh(self) -> None:
        """Read the file again where another process has changed it."""
        if not self.path.is_file():
            self._document = {"format": FORMAT, "settings": {}, "steps": {}}
            self.settings = CommissionSettings()
            return
        changed_ns = self.path.stat().st_mtime_ns
        if changed_ns == self._seen_ns:
            return
        document = read_json(self.path)
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise InputError(f"{self.path}: is no {FORMAT}; give another folder, or move the file away")
        self.settings = validate_settings(document.get("settings", {}))
        self._document, self._seen_ns = document, changed_ns

    @contextmanager
    def lock(self) -> Generator[int]:
        """Let one program at a time run a step or take views; yield the lock, which commands inherit.

        InputError while another program does, or a command that a killed one began has not ended yet.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        try:
            handle = lock_folder(self.folder)
        except BlockingIOError as error:
            raise InputError(f"{self.folder}: another program runs a step of it; wait, or end it") from error
        try:
            yield handle
        finally:
            os.close(handle)

    def change_settings(self, changes: Mapping[str, Any]) -> None:
        """Replace some settings; SettingsError with the first one that does not fit, and nothing is changed."""
        self.refresh()
        before = self._document["settings"]
        merged = {**before, **_write_moments(changes)}
        settings = validate_settings(merged)
        if self.get_record("cameras") is not None:
            self._document.setdefault("cameras", identify_cameras(self.settings))
        self.settings = settings
        self._document["settings"] = merged
        if not self.has_other_cameras:
            self._document.pop("former_settings", None)
        else:
            self._document.setdefault("former_settings", before)
        self._write()

    @property
    def has_other_cameras(self) -> bool:
        """True if the settings name other cameras than those that results were made with."""
        return self._document.get("cameras", identify_cameras(self.settings)) != identify_cameras(
            self.settings
        )

    @property
    def former_source(self) -> str:
        """What the cameras were that results were made with; empty where there are none."""
        return self._document.get("cameras", {}).get("source", "")

    def begin_former(self, name: str) -> str:
        """Return the folder for what other cameras have left: the one that was begun, or ``name``."""
        self.refresh()
        if "former" not in self._document:
            self._document["former"] = name
            self._write()
        return self._document["former"]

    def format_former(self) -> str:
        """Return the state as it was with the former cameras, for their folder."""
        kept = {
            key: self._document[key]
            for key in ("format", "steps", "written", "cameras")
            if key in self._document
        }
        return to_json({**kept, "settings": self._document.get("former_settings", {})}) + "\n"

    def end_former(self, gone: Collection[str]) -> None:
        """Forget the steps of other cameras, and those answers ``gone`` that have not been changed since."""
        former = self._document.get("former_settings", {})
        settings = self._document["settings"]
        kept = {key: value for key, value in settings.items() if key not in gone or value != former.get(key)}
        self.settings = validate_settings(kept)
        self._document = {"format": FORMAT, "settings": kept, "steps": {}}
        self._write()

    def finish(self, step: str, result: Mapping[str, Any], inputs: Sequence[str]) -> None:
        """Record that a step is finished, with what it was made from."""
        self.refresh()
        self._document["steps"][step] = {
            "finished_ms": time_ns() // 1_000_000,
            "result": dict(result),
            "inputs": {name: _fingerprint(self.folder / name) for name in inputs},
        }
        if step == "cameras":
            self._document["cameras"] = identify_cameras(self.settings)
        self._write()

    def keep_written(self, name: str, text: str) -> None:
        """Remember a text that is about to be written into a file, which is then this program's own."""
        self.refresh()
        self._document.setdefault("written", {})[name] = sha256(text.encode()).hexdigest()
        self._write()

    def is_as_written(self, name: str) -> bool:
        """Return whether nobody has changed a file since this program wrote it."""
        return _fingerprint(self.folder / name) == self._document.get("written", {}).get(name)

    def reopen(self, step: str) -> None:
        """Forget that a step was finished."""
        self.refresh()
        if self._document["steps"].pop(step, None) is not None:
            self._write()

    def get_record(self, step: str) -> dict[str, Any] | None:
        """Return when a step was finished, its result and inputs; None while it was not."""
        return self._document["steps"].get(step)

    def is_outdated(self, step: str) -> bool:
        """Return whether what a finished step was made from has changed since."""
        record = self.get_record(step)
        return record is not None and any(
            _fingerprint(self.folder / name) != digest for name, digest in record["inputs"].items()
        )

    def _write(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        write_text(self.path, to_json(self._document) + "\n")
        self._seen_ns = self.path.stat().st_mtime_ns


def _write_moments(value: Any) -> Any:
    """Return settings with ``now`` under begin and end as the present moment, and moments as texts for JSON."""
    if is_dict(value):
        return {
            key: datetime.now(UTC).isoformat(timespec="milliseconds")
            if key in _MOMENTS and one == "now"
            else _write_moments(one)
            for key, one in value.items()
        }
    if is_list_or_tuple(value):
        return [_write_moments(one) for one in value]
    return value.isoformat() if isinstance(value, datetime) else value


def _fingerprint(path: Path) -> str:
    """Return the SHA-256 of a file; empty where there is none."""
    return hash_file(path) if path.is_file() else ""


def validate_settings(values: Mapping[str, Any]) -> CommissionSettings:
    """Return the settings; SettingsError with the first key that does not fit, its value and the reason."""
    try:
        return CommissionSettings.model_validate(dict(values))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise SettingsError(f"{key} = {first['input']!r}: {describe_fault(first)}") from error


def parse_assignments(words: Sequence[str], present: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that ``KEY=VALUE`` words change; a VALUE is TOML, else a text; ``a.b`` is a key of a table.

    ``present`` are the settings as they are, whose other keys stay.

    Raises
    ------
    SettingsError
        For a word that is no assignment.
    """
    changes: dict[str, Any] = {}
    for word in words:
        key, equals, text = word.partition("=")
        if not equals or not key:
            raise SettingsError(f"--set {word}: give KEY=VALUE, such as core=cam0")
        try:
            value = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            value = text
        table, *below = key.split(".")
        if below:
            value = {**present.get(table, {}), **changes.get(table, {}), ".".join(below): value}
        changes[table] = value
    return changes
