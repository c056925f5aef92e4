"""Reading of bulk densities: a CSV table over time, or named products in TOML."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict

from beltscape.core.errors import InputError, suggest_name
from beltscape.core.quantities import DENSITY, DENSITY_SIGMA
from beltscape.files.csv_table import read_csv
from beltscape.files.paths import AnyPath, as_path
from beltscape.files.toml_text import read_toml, validate

DensityValue = Annotated[float, DENSITY]
"""A bulk density, kg/m³."""
DensitySigma = Annotated[float, DENSITY_SIGMA]
"""One standard deviation of a bulk density, kg/m³."""
HEADER = ("timestamp_s", "density_kg_m3", "sigma_kg_m3")
"""Columns of a table; the last one is optional."""


class Product(BaseModel):
    """A bulk material."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    density_kg_m3: DensityValue
    """Bulk density as it lies on the belt."""
    sigma_kg_m3: DensitySigma = 0.0
    """One standard deviation of it."""


def read_products(path: AnyPath) -> dict[str, Product]:
    """Read products.toml: ``[name]`` with ``density_kg_m3`` and, if known, ``sigma_kg_m3``."""
    path = as_path(path)
    tables = read_toml(path)
    for name, table in tables.items():
        if not isinstance(table, dict):
            raise InputError(f"{path}: {name} = {table!r}: write [name] and density_kg_m3 = … below it")
    products = {name: validate(path, Product, table) for name, table in tables.items()}
    if not products:
        raise InputError(f"{path}: no product in it; write [name] and density_kg_m3 = … below it")
    return products


def find_product(path: Path, name: str) -> Product:
    """Return a product of the file; InputError with the available names otherwise."""
    products = read_products(path)
    if name not in products:
        hint = suggest_name(name, products) or f"there are {', '.join(products)}"
        raise InputError(f"{path}: no product {name}; {hint}")
    return products[name]


def read_density_table(path: Path) -> list[tuple[int, float, float]]:
    """Read CSV ``timestamp_s,density_kg_m3[,sigma_kg_m3]`` as (time in ns, density, σ) per row, in order of time.

    Raises
    ------
    InputError
        When a value is not a number or not a density, or times do not increase.
    """
    table: list[tuple[int, float, float]] = []
    for line in read_csv(path, HEADER[:2], HEADER[2:]):
        time_ns, density = (
            round(line.parse_number(0, "timestamp_s") * 1e9),
            line.parse_number(1, "density_kg_m3"),
        )
        sigma = line.parse_number(2, "sigma_kg_m3") if line.values[2:] else 0.0
        for name, value, quantity in zip(HEADER[1:], (density, sigma), (DENSITY, DENSITY_SIGMA), strict=True):
            if refusal := quantity.find_refusal(value):
                raise line.error(f"{name} {value:g} {refusal}")
        if sigma >= density:
            raise line.error(f"sigma_kg_m3 {sigma:g} is not below density_kg_m3 {density:g}; decimal commas?")
        if table and time_ns <= table[-1][0]:
            raise line.error(
                f"timestamp_s {line.values[0]} is not after the row before; sort the rows by time"
            )
        table.append((time_ns, density, sigma))
    return table
