"""Captures that are written once for all tests of recordings."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.once import make_once
from tests.reprocessing.recordings.captures import NAME, write_capture


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture of three cameras and five frames; no test writes into it."""
    return make_once(tmp_path_factory, "recorded", _write) / NAME


def _write(folder: Path) -> None:
    write_capture(folder / NAME)
