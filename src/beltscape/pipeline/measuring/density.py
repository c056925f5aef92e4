"""Files that tell a bulk density → the density that a flow is weighed with."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beltscape.files.tables.density import find_product, read_density_table
from beltscape.measure.flow.records.density import Density


def density_from_table(path: Path) -> Density:
    """Density over time from a CSV table; InputError where it does not fit."""
    times, densities, sigmas = zip(*read_density_table(path), strict=True)
    return Density(np.array(times, np.int64), np.array(densities), np.array(sigmas))


def density_from_product(products: Path, name: str) -> Density:
    """A product's density, of a TOML file of products; InputError where it is not among them."""
    product = find_product(products, name)
    return Density.constant(product.density_kg_m3, product.sigma_kg_m3, name)
