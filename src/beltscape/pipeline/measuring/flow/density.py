"""Bulk density of a flow, read from a table over time or from a list of products."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beltscape.files.tables.density import find_product, read_density_table
from beltscape.measure.flow.records.density import Density


def read_density_over_time(path: Path) -> Density:
    """Return the density over time from a CSV table; InputError if the table is invalid."""
    times, densities, sigmas = zip(*read_density_table(path), strict=True)
    return Density(np.array(times, np.int64), np.array(densities), np.array(sigmas))


def read_product_density(products: Path, name: str) -> Density:
    """Return the density of one product of a TOML file; InputError if it is not in the file."""
    product = find_product(products, name)
    return Density.constant(product.density_kg_m3, product.sigma_kg_m3, name)
