"""A calibration module: known solids on a base plate, as described in module.toml."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator

from beltscape.core.quantities import MODULE_SIDE, PLATE, SOLID
from beltscape.files.paths import AnyPath, as_path
from beltscape.files.toml_text import read_toml, validate

Size = Annotated[float, SOLID]
Side = Annotated[float, MODULE_SIDE]
Thickness = Annotated[float, PLATE]
Position = tuple[
    Annotated[float, Field(allow_inf_nan=False)],
    Annotated[float, Field(allow_inf_nan=False)],
]
"""x along the base's length, y along its width, mm, from its centre."""
Name = Annotated[str, Field(min_length=1)]


class Base(BaseModel):
    """The plate that carries the solids."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    size_mm: tuple[Side, Side, Thickness]
    """Length (x), width (y), thickness (z); its upper face is z = 0."""


class Cube(BaseModel):
    """A cube with edges parallel to the base's."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: Name
    edge_mm: Size
    center_mm: Position
    """Centre of its footprint."""


class Sphere(BaseModel):
    """A sphere that rests on the base."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: Name
    diameter_mm: Size
    center_mm: Position


class Cylinder(BaseModel):
    """An upright cylinder."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: Name
    diameter_mm: Size
    height_mm: Size
    center_mm: Position


Feature = Cube | Sphere | Cylinder


class Module(BaseModel):
    """A module in its own frame: origin at the centre of the base's upper face, x along its length, z up."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: str = "module"
    base: Base
    cube: tuple[Cube, ...] = ()
    sphere: tuple[Sphere, ...] = ()
    cylinder: tuple[Cylinder, ...] = ()

    @model_validator(mode="after")
    def _check_names(self) -> Module:
        names = {"base"}
        for feature in self.features:
            if feature.name in names:
                raise ValueError(f"the name {feature.name} is used twice; give every feature its own name")
            names.add(feature.name)
        return self

    @property
    def features(self) -> tuple[Feature, ...]:
        """Return all solids on the base: cubes, then spheres, then cylinders, each in the file's order."""
        return (*self.cube, *self.sphere, *self.cylinder)


def read_module(path: AnyPath) -> Module:
    """Read module.toml, or raise InputError naming the invalid key."""
    path = as_path(path)
    return validate(path, Module, read_toml(path))
