"""What every test shares: hypothesis without a clock, and where the optional data lies."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("beltscape", deadline=None, max_examples=60, derandomize=True)
settings.load_profile("beltscape")

REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "real"


@pytest.fixture
def real_data():
    """A function name → folder of recorded data; the test is skipped where there is none."""

    def folder(name: str) -> Path:
        path = REAL_DATA / name
        if not path.is_dir():
            pytest.skip(f"optional data: ../shared/data/real/{name} is not there")
        return path

    return folder
