"""project.toml: one tree of settings for a running system; each room declares its own, here they are nested.

The page's own settings are added above, in `beltscape.service.project`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Generic, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from beltscape.alarms.settings import AlarmSettings
from beltscape.core.errors import InputError
from beltscape.files.documents.toml_text import read_toml, validated
from beltscape.files.tables.density import DENSITY_LIMITS
from beltscape.measure.flow.records.density import Density, unknown_density
from beltscape.measure.flow.settings import FlowSettings
from beltscape.measure.volume.settings import SURCHARGE_DEG, Surcharge
from beltscape.pipeline.measuring.density import density_of_product, density_of_table
from beltscape.sinks.settings import CsvSettings, HistorySettings, RecordingSettings
from beltscape.sources.encoder.settings import EncoderSettings
from beltscape.sources.genicam.settings import CamerasSettings
from beltscape.stereo.multiview.settings import MultiviewSettings

Preset = Literal["fast", "standard", "fine"]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class MatchingSettings(_Table):
    """How depth is made of a frame set: the table [matching]."""

    preset: Preset = "fast"
    """As of ``reconstruct --preset``."""
    width_px: Annotated[int, Field(ge=128, le=8192)] | None = None
    """Images are made smaller, to about this width, before they are matched; None: as they are."""
    load_mm: Annotated[float, Field(gt=0, le=10_000)] = 400.0
    """Height over the empty belt that a load may reach."""
    threads: Annotated[int, Field(ge=0, le=256)] = 0
    """0: as many as there are cores."""

    def multiview(self) -> MultiviewSettings:
        """The matcher's own settings."""
        return MultiviewSettings.preset(self.preset).model_copy(update={"threads": self.threads})


class CaptureSettings(_Table):
    """A recorded capture in place of cameras: the table [capture]."""

    folder: Path
    frames_per_s: Annotated[float, Field(gt=0, le=1000)] | None = None
    """Where the capture has no encoder.csv."""
    loop: bool = False
    """Begin again at its end; the belt goes on."""


class DensitySettings(_Table):
    """Bulk density, told in one way: the table [density]."""

    kg_m3: Annotated[float, Field(gt=DENSITY_LIMITS[0], le=DENSITY_LIMITS[1])] | None = None
    sigma_kg_m3: Annotated[float, Field(ge=0, le=DENSITY_LIMITS[1])] = 0.0
    """One standard deviation of ``kg_m3``."""
    table: Path | None = None
    """CSV timestamp_s,density_kg_m3[,sigma_kg_m3]; times as of the frames."""
    products: Path | None = None
    """TOML [name] density_kg_m3, sigma_kg_m3."""
    product: str | None = None
    """One of the products."""


class QueueSettings(_Table):
    """Between cameras and measurement: the table [queue]."""

    frames: Annotated[int, Field(ge=1, le=64)] = 2
    """Frame sets that may wait; where a further one comes the oldest is left out and counted."""


class WatchSettings(_Table):
    """What is looked for in the measured surface, and how often: the table [watch]."""

    lumps_every_s: Annotated[float, Field(ge=0, le=86_400)] = 10.0
    """Largest lump; 0: never."""
    edges_every_s: Annotated[float, Field(ge=0, le=86_400)] = 10.0
    """How far the belt runs off; 0: never."""
    surcharge_deg: Surcharge = SURCHARGE_DEG
    """Of a full belt, as of ``measure volume``: what the fill level is measured against."""


class RunSettings(_Table):
    """All of project.toml but for the page. Paths are relative to its folder."""

    name: Annotated[str, Field(min_length=1, max_length=80)] = "belt"
    rig: Path = Path("rig.json")
    """Of beltscape calibrate."""
    empty: Path = Path("belt.json")
    """The empty belt: belt.json, a frame folder or a whole reconstruction of it."""
    data: Path = Path("data")
    """Folder for history, recordings and users."""
    cameras: CamerasSettings | None = None
    capture: CaptureSettings | None = None
    encoder: EncoderSettings = EncoderSettings()
    matching: MatchingSettings = MatchingSettings()
    flow: FlowSettings = FlowSettings()
    density: DensitySettings = DensitySettings()
    queue: QueueSettings = QueueSettings()
    watch: WatchSettings = WatchSettings()
    alarms: AlarmSettings = AlarmSettings()
    history: HistorySettings = HistorySettings()
    recording: RecordingSettings = RecordingSettings()
    csv: CsvSettings = CsvSettings()


Settings = TypeVar("Settings", bound=RunSettings)


@dataclass(frozen=True, slots=True)
class Project(Generic[Settings]):
    """A project.toml that was read."""

    path: Path
    settings: Settings

    def place(self, path: Path) -> Path:
        """A path of the settings, as seen from here."""
        return self.path.parent / path


def read_project(path: Path, model: type[Settings]) -> Project[Settings]:
    """Read and check project.toml as a whole.

    Raises
    ------
    InputError
        One line that names the key, its value and the mend; an unknown key with the nearest known one.
    """
    project = Project(path, validated(path, model, read_toml(path)))
    settings = project.settings
    if (settings.cameras is None) == (settings.capture is None):
        raise InputError(f"{path}: give either [cameras] or [capture], one of them")
    for key in ("rig", "empty"):
        place = project.place(getattr(settings, key))
        if not place.exists():
            raise InputError(
                f"{path}: {key} = {str(place)!r}: no such file; see beltscape calibrate, beltscape measure belt"
            )
    _require_encoder(project)
    told = settings.density
    if settings.alarms.overload.mass_flow_t_h is not None and told == DensitySettings():
        raise InputError(
            f"{path}: [alarms.overload] mass_flow_t_h = {settings.alarms.overload.mass_flow_t_h:g} needs a bulk "
            "density; give [density] kg_m3, table or product"
        )
    return project


def _require_encoder(project: Project[Settings]) -> None:
    """The core camera counts the encoder if, and only if, both tables say so."""
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


def density_of(project: Project[RunSettings]) -> Density:
    """Bulk density as the project tells it."""
    told = project.settings.density
    ways = [name for name in ("kg_m3", "table", "products") if getattr(told, name) is not None]
    if len(ways) > 1:
        raise InputError(f"{project.path}: [density] {' and '.join(ways)}: say the density in one way only")
    if (told.product is None) != (told.products is None):
        raise InputError(f"{project.path}: [density] product goes with products: give both")
    if told.products is not None and told.product is not None:
        return density_of_product(project.place(told.products), told.product)
    if told.table is not None:
        return density_of_table(project.place(told.table))
    return unknown_density() if told.kg_m3 is None else Density.constant(told.kg_m3, told.sigma_kg_m3)
