"""The numbers that the paper states, as data/paper.toml has them."""

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
    """As the tables call it."""
    of: tuple[str, ...]
    """"name quantity" as `measure features` has them; the mean of several."""
    actual_mm: float
    table2_mm: float
    """By the paper's method."""
    table3_mm: float | None = None
    """By its time-of-flight camera; None: the table has none."""


class Density(_Part):
    """Points with speckle over points without, where there is material."""

    place: str
    ratio: float


class PaperNumbers(_Part):
    """All of them."""

    source: str
    doi: str
    density: Density
    dimension: tuple[Dimension, ...]


def read_paper_numbers() -> PaperNumbers:
    """Read the file that ships with Beltscape."""
    path = Path(str(files("beltscape") / "data" / "paper.toml"))
    return validate(path, PaperNumbers, read_toml(path))
