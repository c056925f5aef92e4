"""Fixtures: simulated cameras in a network namespace of their own."""

from __future__ import annotations

import pytest

from beltscape.core.errors import BeltscapeError
from beltscape.sources.fake_genicam.simulated_cameras import FIRST_ADDRESS, own_network


@pytest.fixture
def fake_network():
    """Everything started within has five loopback addresses for cameras, and no other network."""
    try:
        from beltscape.sources.genicam.aravis import load_aravis

        load_aravis()
        network = own_network(f"127.0.0.{FIRST_ADDRESS + i}" for i in range(5))
        network.__enter__()
    except BeltscapeError as error:
        pytest.skip(str(error))
    yield
    network.__exit__(None, None, None)
