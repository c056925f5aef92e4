"""Fixtures of the kernels' tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from beltscape.kernels.backend import gpu_failures


@pytest.fixture
def no_failure() -> Iterator[None]:
    """Let no failure of a GPU reach another test."""
    gpu_failures.clear()
    yield
    gpu_failures.clear()
