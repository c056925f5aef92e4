"""The file of a material test: loads, known masses or volumes, references, samples, and where runs were measured."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, model_validator

from beltscape.core.quantities import BELT_LENGTH, DENSITY, DENSITY_SIGMA, MOISTURE
from beltscape.metrology.observations import OtherEffect, ReferenceStandard, Sample

Line = Annotated[str, Field(max_length=120, pattern=r"^[^\x00-\x1f]*$")]
"""A text of one line."""
_Positive = Annotated[float, Field(gt=0, lt=1e12, allow_inf_nan=False)]
_Sigma = Annotated[float, Field(ge=0, lt=1e12, allow_inf_nan=False)]
_Percent = Annotated[float, Field(ge=0, le=20, allow_inf_nan=False)]
Freedom = Annotated[float, Field(ge=1, le=1e9, allow_inf_nan=False)] | None
"""Degrees of freedom of a σ; None: it is taken as exact."""
_LEAST_LOADS = 2
"""Loads of a material test; a belt scale is tested at several, too (OIML R 50-2:2014)."""


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class StretchSettings(_Table):
    """Where something was measured: a period of the plant's history, its records, or a result of `measure flow`."""

    begin: AwareDatetime | None = None
    end: AwareDatetime | None = None
    """System clock, with its offset from UTC."""
    records: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]] | None = None
    """First and last record."""
    flow: Path | None = None
    """Folder of `measure flow`, relative to the test's file."""

    @model_validator(mode="after")
    def _one_place(self) -> StretchSettings:
        by_time = (self.begin, self.end) != (None, None)
        given = [name for name, is_given in (("begin and end", by_time), ("records", self.records is not None),
                                             ("flow", self.flow is not None)) if is_given]  # fmt: skip
        if len(given) != 1:
            what = f"{' and '.join(given)} are given" if given else "nothing says where it was measured"
            raise ValueError(f"{what}; give either begin and end, records or flow")
        if by_time and (self.begin is None or self.end is None or self.begin >= self.end):
            raise ValueError("give both begin and end, in this order")
        if self.records is not None and self.records[0] > self.records[1]:
            raise ValueError(f"records = {list(self.records)}: the first is after the last")
        return self


class ReferenceRunSettings(StretchSettings):
    """A run: a table [[runs]]."""

    load: Annotated[str, Field(min_length=1, max_length=40)]
    """Name of its load; runs of one load are repetitions."""
    mass_kg: _Positive | None = None
    volume_m3: _Positive | None = None
    ticket: Line = ""
    """Number of the weighing ticket."""
    picture: Path | None = None
    """An image of the load, relative to the test's file; without it that of ``flow``, where there is one."""

    @model_validator(mode="after")
    def _one_reference(self) -> ReferenceRunSettings:
        if (self.mass_kg is None) == (self.volume_m3 is None):
            raise ValueError(f"load {self.load!r}: give either mass_kg or volume_m3")
        return self


class MassReferenceSettings(_Table):
    """The scale that all masses come from: the table [reference]."""

    name: Line = ""
    certificate: Line = ""
    sigma_percent: _Percent = 0.0
    """One standard deviation of its calibration, in proportion to the mass."""
    sigma_kg: _Sigma = 0.0
    """One standard deviation of its calibration, the same for every mass."""
    resolution_kg: _Sigma = 0.0
    degrees_of_freedom: Freedom = None

    def to_reference(self) -> ReferenceStandard:
        """Return the reference."""
        shares = self.sigma_percent / 100, self.sigma_kg, self.resolution_kg
        return ReferenceStandard(self.name, self.certificate, *shares, self.degrees_of_freedom or math.inf)


class VolumeReferenceSettings(_Table):
    """What all known volumes come from: the table [volume_reference]."""

    name: Line = ""
    certificate: Line = ""
    sigma_percent: _Percent = 0.0
    sigma_m3: _Sigma = 0.0
    degrees_of_freedom: Freedom = None

    def to_reference(self) -> ReferenceStandard:
        """Return the reference."""
        shares = self.sigma_percent / 100, self.sigma_m3, 0.0
        return ReferenceStandard(self.name, self.certificate, *shares, self.degrees_of_freedom or math.inf)


class DensitySampleSettings(_Table):
    """A bulk density that was determined apart from the belt, as by a weighed container: [density], [dry_density]."""

    kg_m3: Annotated[float, DENSITY]
    sigma_kg_m3: Annotated[float, DENSITY_SIGMA, Field(gt=0)]
    degrees_of_freedom: Freedom = None

    def to_sample(self) -> Sample:
        """Return the sample."""
        return Sample(self.kg_m3, self.sigma_kg_m3, self.degrees_of_freedom or math.inf)


class MoistureSampleSettings(_Table):
    """The moisture of a dried sample: the table [moisture]."""

    percent: Annotated[float, MOISTURE, Field(lt=95)]
    sigma_percent: Annotated[float, Field(gt=0, le=20)]
    degrees_of_freedom: Freedom = None

    def to_sample(self) -> Sample:
        """Return the sample as a share."""
        return Sample(self.percent / 100, self.sigma_percent / 100, self.degrees_of_freedom or math.inf)


class OtherEffectSettings(_Table):
    """A further source of error, such as spilt material: a table [[effects]]."""

    name: Annotated[str, Field(min_length=1, max_length=60)]
    sigma_percent: Annotated[float, Field(gt=0, le=20)]
    type: Literal["A", "B"] = "B"
    degrees_of_freedom: Freedom = None

    def to_effect(self) -> OtherEffect:
        """Return the effect."""
        return OtherEffect(
            self.name, self.sigma_percent / 100, self.type, self.degrees_of_freedom or math.inf
        )


class ZeroTestSettings(StretchSettings):
    """The empty belt over whole revolutions: the table [zero]."""

    revolutions: Annotated[int, Field(ge=1, le=1000)]


class MaterialTestSettings(_Table):
    """All of a material test's file."""

    name: Annotated[str, Field(min_length=1, max_length=80)] = "material test"
    operator: Line = ""
    """Who made the test."""
    place: Line = ""
    product: Line = ""
    """What material was sent over the belt."""
    remark: Annotated[str, Field(max_length=500)] = ""
    confidence: Annotated[float, Field(ge=0.5, le=0.999)] = 0.95
    belt_length_m: Annotated[float, BELT_LENGTH] | None = None
    """Length of the endless belt; without it that of [health.belt] in project.toml."""
    reference: MassReferenceSettings = MassReferenceSettings()
    volume_reference: VolumeReferenceSettings = VolumeReferenceSettings()
    density: DensitySampleSettings | None = None
    dry_density: DensitySampleSettings | None = None
    moisture: MoistureSampleSettings | None = None
    zero: ZeroTestSettings | None = None
    runs: Annotated[tuple[ReferenceRunSettings, ...], Field(min_length=2, max_length=500)]
    effects: tuple[OtherEffectSettings, ...] = ()

    @model_validator(mode="after")
    def _known_references(self) -> MaterialTestSettings:
        mass, volume = self.reference, self.volume_reference
        if any(run.mass_kg for run in self.runs) and not (mass.sigma_percent or mass.sigma_kg):
            raise ValueError(
                "reference: give sigma_percent or sigma_kg of the scale; no mass is known exactly"
            )
        if any(run.volume_m3 for run in self.runs) and not (volume.sigma_percent or volume.sigma_m3):
            raise ValueError("volume_reference: give sigma_percent or sigma_m3; no volume is known exactly")
        return self

    @property
    def loads(self) -> tuple[str, ...]:
        """Return the names of the loads."""
        return tuple(dict.fromkeys(run.load for run in self.runs))

    @property
    def lacks_loads(self) -> bool:
        """Return whether there are too few loads for linearity."""
        return len(self.loads) < _LEAST_LOADS
