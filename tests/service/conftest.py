"""Fixture: servers of the sample application."""

from __future__ import annotations

from typing import Any

import pytest

from beltscape.service.access import Access, AccessSettings
from beltscape.service.hosting import serve
from tests.service.access.sample_app import CHEAP, PASSWORD, make_application
from tests.service.running import Web


@pytest.fixture
def start(tmp_path):
    """Return a function that serves the sample application; servers are stopped at the end."""
    opened = []

    def start_server(web: Web | None = None, **access: Any):
        access_control = Access(tmp_path, AccessSettings(**access), CHEAP)
        opened.append(access_control)
        if access_control.accounts.is_setup_open:
            access_control.accounts.add("anna", "operator", PASSWORD)
        running = serve(make_application(access_control), web or Web())
        opened.append(running)  # pyrefly: ignore[bad-argument-type]
        return running

    yield start_server
    for one in reversed(opened):
        one.close()
