"""A calibration module: known solids on a base plate, as module.toml describes them."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator

from beltscape.files.documents.toml_text import read_toml, validated
from beltscape.files.folders.paths import AnyPath, as_path

Millimetres = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Place = tuple[
    Annotated[float, Field(allow_inf_nan=False)],
    Annotated[float, Field(allow_inf_nan=False)],
]
"""x along the base's length, y along its width, mm, from its middle."""
Name = Annotated[str, Field(min_length=1)]


class Base(BaseModel):
    """The plate everything stands on."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    size_mm: tuple[Millimetres, Millimetres, Millimetres]
    """Length (x), width (y), thickness (z); its upper face is z = 0."""


class Cube(BaseModel):
    """A cube, its edges along the base's."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: Name
    edge_mm: Millimetres
    center_mm: Place
    """Of its footprint."""


class Sphere(BaseModel):
    """A sphere that rests on the base."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: Name
    diameter_mm: Millimetres
    center_mm: Place


class Cylinder(BaseModel):
    """An upright cylinder."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: Name
    diameter_mm: Millimetres
    height_mm: Millimetres
    center_mm: Place


Feature = Cube | Sphere | Cylinder


class Module(BaseModel):
    """A module in its own frame: origin in the middle of the base's upper face, x along its length, z up."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: str = "module"
    base: Base
    cube: tuple[Cube, ...] = ()
    sphere: tuple[Sphere, ...] = ()
    cylinder: tuple[Cylinder, ...] = ()

    @model_validator(mode="after")
    def _names_differ(self) -> Module:
        seen = {"base"}
        for feature in self.features:
            if feature.name in seen:
                raise ValueError(f"the name {feature.name} is taken twice; give every feature its own")
            seen.add(feature.name)
        return self

    @property
    def features(self) -> tuple[Feature, ...]:
        """Everything on the base: cubes, then spheres, then cylinders, each in the file's order."""
        return (*self.cube, *self.sphere, *self.cylinder)


def read_module(path: AnyPath) -> Module:
    """Read module.toml, or InputError naming the key that does not fit."""
    path = as_path(path)
    return validated(path, Module, read_toml(path))
