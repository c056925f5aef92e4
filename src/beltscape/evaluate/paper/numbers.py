"""The paper's published numbers, read from data/paper.toml."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from beltscape.files.documents.toml_text import read_toml, validate


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Dimension(_Part):
    """A row of the paper's Tables 2 and 3."""

    row: int
    name: str
    """Name in the tables."""
    of: tuple[str, ...]
    """"name quantity" as in `measure features`; the mean of several."""
    actual_mm: float
    table2_mm: float
    """Dimension by the paper's method."""
    table3_mm: float | None = None
    """Dimension by the paper's time-of-flight camera; None: the table has none."""


class Density(_Part):
    """Ratio of measured points on the material with and without speckle."""

    place: str
    ratio: float


class PaperNumbers(_Part):
    """All published numbers."""

    source: str
    doi: str
    density: Density
    dimension: tuple[Dimension, ...]


def read_paper_numbers() -> PaperNumbers:
    """Read the numbers that ship with Beltscape."""
    path = Path(str(files("beltscape") / "data" / "paper.toml"))
    return validate(path, PaperNumbers, read_toml(path))
