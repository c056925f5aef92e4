"""Bulk densities in files: a table over time, or named products."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.errors import InputError
from beltscape.files.documents.toml_text import read_toml, validated
from beltscape.files.folders.paths import AnyPath, as_path
from beltscape.files.tables.csv_table import read_csv

DENSITY_LIMITS = (0.0, 30_000.0)
"""kg/m³, the first excluded: nothing that is conveyed is heavier."""
DensityValue = Annotated[float, Field(gt=DENSITY_LIMITS[0], le=DENSITY_LIMITS[1], allow_inf_nan=False)]


class Product(BaseModel):
    """A material by its name."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    density_kg_m3: DensityValue
    """Bulk density as it lies on the belt."""
    sigma_kg_m3: Annotated[float, Field(ge=0, le=10_000)] = 0.0
    """One standard deviation of it."""


def read_products(path: AnyPath) -> dict[str, Product]:
    """products.toml: ``[name]`` with ``density_kg_m3`` and, where it is known, ``sigma_kg_m3``."""
    path = as_path(path)
    tables = read_toml(path)
    for name, table in tables.items():
        if not isinstance(table, dict):
            raise InputError(f"{path}: {name} = {table!r}: write [name] and density_kg_m3 = … below it")
    products = {name: validated(path, Product, table) for name, table in tables.items()}
    if not products:
        raise InputError(f"{path}: no product in it; write [name] and density_kg_m3 = … below it")
    return products


def product_named(path: Path, name: str) -> Product:
    """One of a file's products, or InputError naming those there are."""
    products = read_products(path)
    if name not in products:
        near = get_close_matches(name, products, n=1)
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(products)}"
        raise InputError(f"{path}: no product {name}; {hint}")
    return products[name]


def read_density_table(path: Path) -> list[tuple[int, float, float]]:
    """CSV ``timestamp_s,density_kg_m3[,sigma_kg_m3]`` → (time in ns, density, σ) per row, in order of time.

    Raises
    ------
    InputError
        When a value is no number or no density, or times do not grow.
    """
    table: list[tuple[int, float, float]] = []
    for line in read_csv(path, ("timestamp_s", "density_kg_m3"), ("sigma_kg_m3",)):
        time_ns, density = round(line.number_in(0, "timestamp_s") * 1e9), line.number_in(1, "density_kg_m3")
        sigma = line.number_in(2, "sigma_kg_m3") if line.values[2:] else 0.0
        if not DENSITY_LIMITS[0] < density <= DENSITY_LIMITS[1] or sigma < 0:
            raise line.wrong(f"a density of {density:g} ± {sigma:g} kg/m³; give one above 0, up to 30000")
        if table and time_ns <= table[-1][0]:
            raise line.wrong(
                f"timestamp_s {line.values[0]} is not after the row before; sort the rows by time"
            )
        table.append((time_ns, density, sigma))
    return table
