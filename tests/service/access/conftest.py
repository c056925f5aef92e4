"""Doors with users, closed at the end."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI

from beltscape.service.access import Access, AccessSettings
from service.access.door import CHEAP, PASSWORD, application


@pytest.fixture
def make(tmp_path):
    """A function of settings that gives a door, closed at the end."""
    doors: list[Access] = []

    def door(folder: Path = tmp_path, **settings: Any) -> Access:
        doors.append(Access(folder, AccessSettings(**settings), CHEAP))
        return doors[-1]

    yield door
    for one in doors:
        one.close()


@pytest.fixture
def access(make) -> Iterator[Access]:
    """A door with one user of each role."""
    door = make()
    for role in ("engineer", "operator", "viewer"):
        door.accounts.add(f"the-{role}", role, PASSWORD)
    return door


@pytest.fixture
def app(access) -> FastAPI:
    """AppContext the door with one user of each role."""
    return application(access)
