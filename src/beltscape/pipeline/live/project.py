"""project.toml: the settings of the live system; each package declares its own table, and this module joins them.

What the settings refer to is read here, too: the bulk density, the file of the plant's own texts of alarms, and the
cameras of the rig. The page's settings are added in `beltscape.service.project`.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Generic, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from beltscape.alarms.settings import AlarmSettings
from beltscape.alarms.texts import CustomTexts, read_custom_texts
from beltscape.core.errors import InputError
from beltscape.core.quantities import FRAME_RATE, LOAD_HEIGHT
from beltscape.files.density import DensitySigma, DensityValue, find_product, read_density_table
from beltscape.files.toml_text import read_toml, validate
from beltscape.health.settings import HealthSettings
from beltscape.measure.belt.settings import NOTHING_GIVEN, GivenBelt
from beltscape.measure.flow.density import Density, make_unknown_density
from beltscape.measure.flow.settings import FlowSettings
from beltscape.measure.volume.settings import SURCHARGE_DEG, Surcharge
from beltscape.production.settings import (
    ProductionSettings,
    ProductSettings,
    ReportSettings,
    ScaleSettings,
    check_products,
)
from beltscape.sinks.settings import CsvSettings, HistorySettings, RecordingSettings
from beltscape.sources.encoder.settings import EncoderSettings
from beltscape.sources.genicam.settings import CamerasSettings
from beltscape.stereo.consistency.drift import LEAST_FRAMES
from beltscape.stereo.settings import MultiviewSettings, Preset


def read_density_over_time(path: Path) -> Density:
    """Return the density over time from a CSV table; InputError if the table is invalid."""
    times, densities, sigmas = zip(*read_density_table(path), strict=True)
    return Density(np.array(times, np.int64), np.array(densities), np.array(sigmas))


def read_product_density(products: Path, name: str) -> Density:
    """Return the density of one product of a TOML file; InputError if it is not in the file."""
    product = find_product(products, name)
    return Density.constant(product.density_kg_m3, product.sigma_kg_m3, name)


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class MatchingSettings(_Table):
    """Settings of the depth computation: the table [matching]."""

    preset: Preset = "fast"
    """As in ``reconstruct --preset``."""
    width_px: Annotated[int, Field(ge=128, le=8192)] | None = None
    """Approximate width to which images are reduced before they are matched; None: full size."""
    load_mm: Annotated[float, LOAD_HEIGHT] = 400.0
    """Largest height of a load over the empty belt."""
    threads: Annotated[int, Field(ge=0, le=256)] = 0
    """0: one per core; of a worker process one."""
    workers: Annotated[int, Field(ge=0, le=256)] | Literal["auto"] = "auto"
    """Processes that match frame sets side by side: one per core, or this number; 0: this process matches them."""

    def multiview(self) -> MultiviewSettings:
        """Return the matcher's settings."""
        return MultiviewSettings.preset(self.preset).model_copy(update={"threads": self.threads})


class CaptureSettings(_Table):
    """A recorded capture instead of cameras: the table [capture]."""

    folder: Path
    frames_per_s: Annotated[float, FRAME_RATE] | None = None
    """For a capture without encoder.csv."""
    loop: bool = False
    """Restart the capture at its end; the belt position continues."""


class DensitySettings(_Table):
    """Bulk density, given in one form: the table [density]."""

    kg_m3: DensityValue | None = None
    sigma_kg_m3: DensitySigma = 0.0
    """One standard deviation of ``kg_m3``."""
    table: Path | None = None
    """CSV timestamp_s,density_kg_m3[,sigma_kg_m3]; times on the frames' clock."""
    products: Path | None = None
    """TOML [name] density_kg_m3, sigma_kg_m3."""
    product: str | None = None
    """One of the products."""


class QueueSettings(_Table):
    """The queue between cameras and measurement: the table [queue]."""

    frames: Annotated[int, Field(ge=1, le=64)] = 2
    """Capacity in frame sets; when it is full, one is dropped and counted: the one without which the belt stays seen
    most evenly."""


class WatchSettings(_Table):
    """The periodic inspections of the measured surface: the table [watch]."""

    lumps_every_s: Annotated[float, Field(ge=0, le=86_400)] = 10.0
    """Period of the search for the largest lump; 0: never."""
    edges_every_s: Annotated[float, Field(ge=0, le=86_400)] = 10.0
    """Period of the misalignment measurement; 0: never."""
    surcharge_deg: Surcharge = SURCHARGE_DEG
    """Surcharge angle of a full belt, the reference of the fill level, as in ``measure volume``."""
    stale_s: Annotated[float, Field(ge=0.5, le=600)] = 3.0
    """Time without a measured record after which the present load and flow are unknown to the alarms."""
    drift_every_s: Annotated[float, Field(ge=0, le=86_400)] = 60.0
    """Period of the frames from which the drift of the rig is estimated, each with other material; 0: never."""
    drift_frames: Annotated[int, Field(ge=LEAST_FRAMES, le=10_000)] = 120
    """Frames of an estimate: two hours, over which the medians of blocks are known to some 0.01 px."""


class RunSettings(_Table):
    """All tables of project.toml except the page's. Paths are relative to its folder."""

    name: Annotated[str, Field(min_length=1, max_length=80)] = "belt"
    rig: Path = Path("rig.json")
    """From beltscape calibrate."""
    empty: Path = Path("belt.json")
    """The empty belt: belt.json, a frame folder or a whole reconstruction of it."""
    data: Path = Path("data")
    """Folder for history, recordings and users."""
    cameras: CamerasSettings | None = None
    capture: CaptureSettings | None = None
    encoder: EncoderSettings = EncoderSettings()
    belt: GivenBelt = NOTHING_GIVEN
    """What is known of the belt's width, ends or place, for ``empty``."""
    matching: MatchingSettings = MatchingSettings()
    flow: FlowSettings = FlowSettings()
    density: DensitySettings = DensitySettings()
    products: tuple[ProductSettings, ...] = ()
    production: ProductionSettings = ProductionSettings()
    reports: ReportSettings | None = None
    scale: ScaleSettings | None = None
    queue: QueueSettings = QueueSettings()
    watch: WatchSettings = WatchSettings()
    health: HealthSettings = HealthSettings()
    alarms: AlarmSettings = AlarmSettings()
    history: HistorySettings = HistorySettings()
    recording: RecordingSettings = RecordingSettings()
    csv: CsvSettings = CsvSettings()


Settings = TypeVar("Settings", bound=RunSettings)
Settings_co = TypeVar("Settings_co", bound=RunSettings, covariant=True)


@dataclass(frozen=True, slots=True)
class Project(Generic[Settings_co]):
    """The path and the settings of a project.toml."""

    path: Path
    settings: Settings_co

    def resolve(self, path: Path) -> Path:
        """Return a path of the settings relative to the working directory."""
        return self.path.parent / path


def read_project(path: Path, model: type[Settings]) -> Project[Settings]:
    """Read and check the whole project.toml.

    Raises
    ------
    InputError
        One line that names the key, its value and the fix; an unknown key with the most similar valid one.
    """
    project = Project(path, validate(path, model, read_toml(path)))
    settings = project.settings
    if (settings.cameras is None) == (settings.capture is None):
        raise InputError(f"{path}: give either [cameras] or [capture], one of them")
    for key in ("rig", "empty"):
        file = project.resolve(getattr(settings, key))
        if not file.exists():
            raise InputError(
                f"{path}: {key} = {str(file)!r}: no such file; see beltscape calibrate, beltscape measure belt"
            )
    _require_encoder(project)
    _require_density(project)
    return project


def _require_density(project: Project[RunSettings]) -> None:
    """Raise InputError unless products and densities agree, and alarms of a mass have one."""
    path, settings = project.path, project.settings
    problem = check_products(settings.products, settings.production)
    if not problem and settings.products and settings.density != DensitySettings():
        problem = "[density] and [[products]]: a product has a density; remove [density]"
    if problem:
        raise InputError(f"{path}: {problem}")
    is_unknown = settings.density == DensitySettings() and not settings.products
    if settings.alarms.overload.mass_flow_t_h is not None and is_unknown:
        raise InputError(
            f"{path}: [alarms.overload] mass_flow_t_h = {settings.alarms.overload.mass_flow_t_h:g} needs a bulk "
            "density; give [[products]], or [density] kg_m3, table or product"
        )


def _require_encoder(project: Project[RunSettings]) -> None:
    """Raise InputError unless [encoder] and [cameras.encoder] agree on whether the core camera counts the encoder."""
    cameras, kind = project.settings.cameras, project.settings.encoder.kind
    if cameras is None:
        return
    if kind == "camera" and cameras.encoder is None:
        raise InputError(
            f'{project.path}: [encoder] kind = "camera" needs a table [cameras.encoder] with chunk or feature, '
            "and mm_per_count"
        )
    if kind == "none" and cameras.encoder is not None:
        raise InputError(
            f'{project.path}: [cameras.encoder] is given, but [encoder] kind = "none" leaves it unread; '
            'give [encoder] kind = "camera"'
        )


def read_density(project: Project[RunSettings]) -> Density:
    """Return the bulk density of the project's settings."""
    given = project.settings.density
    forms = [name for name in ("kg_m3", "table", "products") if getattr(given, name) is not None]
    if len(forms) > 1:
        raise InputError(f"{project.path}: [density] {' and '.join(forms)}: give the density in one way only")
    if (given.product is None) != (given.products is None):
        raise InputError(f"{project.path}: [density] product goes with products: give both")
    if given.products is not None and given.product is not None:
        return read_product_density(project.resolve(given.products), given.product)
    if given.table is not None:
        return read_density_over_time(project.resolve(given.table))
    return make_unknown_density() if given.kg_m3 is None else Density.constant(given.kg_m3, given.sigma_kg_m3)


def read_alarm_texts(project: Project[RunSettings]) -> CustomTexts:
    """Return the plant's own texts of alarms; InputError with one line where their file cannot be used."""
    texts = project.settings.alarms.texts
    return CustomTexts() if texts is None else read_custom_texts(project.resolve(texts))


def require_cameras_of_banks(project: Project[RunSettings], cameras: Collection[str]) -> None:
    """Raise InputError where a bank of [alarms.cameras_off] has a camera that the rig does not have."""
    for bank, names in project.settings.alarms.cameras_off.banks.items():
        for name in names:
            if name not in cameras:
                raise InputError(
                    f"{project.path}: [alarms.cameras_off] banks.{bank}: the rig has no camera {name!r}; "
                    f"give some of {', '.join(cameras)}"
                )


def describe_alarms(project: Project[RunSettings], cameras: Collection[str]) -> str:
    """Return a line about the settings of the alarms; InputError where they refer to what does not exist."""
    require_cameras_of_banks(project, cameras)
    texts = read_alarm_texts(project).by_language
    counts = ", ".join(f"{len(alarms)} in {language}" for language, alarms in texts.items())
    return f"own texts: {counts or 'none'}"
