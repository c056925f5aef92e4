"""The quick form of a material test: an object of known volume, measured in passing several times."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.errors import SettingsError
from beltscape.metrology.settings import (
    MaterialTestSettings,
    ReferenceRunSettings,
    VolumeReferenceSettings,
)
from beltscape.target.module import Cube, Feature, Module, Sphere, read_module

_LEAST_PASSES = 3
"""Fewer passes tell no scatter. Chosen."""
Term = tuple[float, float]
"""A volume, mm³, and its standard deviation."""


@dataclass(frozen=True, slots=True)
class KnownVolume:
    """An object on the belt, and the volume below its visible surface."""

    name: str
    volume_m3: float
    sigma_m3: float


def make_box(size_mm: Sequence[float], sigma_mm: float) -> KnownVolume:
    """Return a box of three edges with the σ of each."""
    volume, sigma = _multiply([(edge, sigma_mm) for edge in size_mm])
    return KnownVolume("box", volume * 1e-9, sigma * 1e-9)


def make_module(path: Path, sigma_mm: float) -> KnownVolume:
    """Return a calibration module with the σ of each of its dimensions."""
    module = read_module(path)
    terms = list(_list_terms(module, sigma_mm))
    sigma = math.sqrt(sum(one**2 for _, one in terms))
    return KnownVolume(module.name, sum(one for one, _ in terms) * 1e-9, sigma * 1e-9)


def _list_terms(module: Module, sigma_mm: float) -> Iterator[Term]:
    yield _multiply([(edge, sigma_mm) for edge in module.base.size_mm])
    for feature in module.features:
        yield _compute_volume(feature, sigma_mm)


def _compute_volume(feature: Feature, sigma_mm: float) -> Term:
    """Return the volume between the base and what is visible from above.

    Below a sphere's equator nothing is visible: what is measured is the half sphere on a cylinder, 5/3 π r³.
    """
    if isinstance(feature, Cube):
        return feature.edge_mm**3, 3 * feature.edge_mm**2 * sigma_mm
    radius = feature.diameter_mm / 2
    if isinstance(feature, Sphere):
        return 5 / 3 * math.pi * radius**3, 5 / 2 * math.pi * radius**2 * sigma_mm
    return _multiply([(math.pi * radius**2, math.pi * radius * sigma_mm), (feature.height_mm, sigma_mm)])


def _multiply(factors: Sequence[Term]) -> Term:
    """Return the product of independent factors with its σ (GUM 5.1.6)."""
    product = math.prod(value for value, _ in factors)
    return product, product * math.sqrt(sum((sigma / value) ** 2 for value, sigma in factors))


def make_object_settings(
    known: KnownVolume, flows: Sequence[Path], operator: str = "", confidence: float = 0.95
) -> MaterialTestSettings:
    """Return the settings of a test by passes of an object; SettingsError for too few of them."""
    if len(flows) < _LEAST_PASSES:
        raise SettingsError(f"{len(flows)} passes: give the results of {_LEAST_PASSES} or more")
    if not known.sigma_m3 > 0:
        raise SettingsError(
            "--sigma 0: no volume is known exactly; give the standard deviation of an edge, mm"
        )
    return MaterialTestSettings(
        name=f"test object {known.name}",
        operator=operator,
        product=known.name,
        confidence=confidence,
        volume_reference=VolumeReferenceSettings(name=known.name, sigma_m3=known.sigma_m3),
        runs=tuple(
            ReferenceRunSettings(
                load=known.name, volume_m3=known.volume_m3, flow=flow.resolve(), ticket=str(number)
            )
            for number, flow in enumerate(flows, 1)
        ),
    )
