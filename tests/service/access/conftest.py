"""Fixtures: access control with users, closed at the end."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI

from beltscape.service.access import Access, AccessSettings
from tests.service.access.sample_app import CHEAP, PASSWORD, make_application


@pytest.fixture
def make(tmp_path):
    """Return a function that creates access control with given settings."""
    created: list[Access] = []

    def make_access(folder: Path = tmp_path, **settings: Any) -> Access:
        created.append(Access(folder, AccessSettings(**settings), CHEAP))
        return created[-1]

    yield make_access
    for access in created:
        access.close()


@pytest.fixture
def access(make) -> Iterator[Access]:
    """Access control with one user of each role."""
    access = make()
    for role in ("engineer", "operator", "viewer"):
        access.accounts.add(f"the-{role}", role, PASSWORD)
    return access


@pytest.fixture
def app(access) -> FastAPI:
    """The sample application with one user of each role."""
    return make_application(access)
