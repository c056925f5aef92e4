"""Fixtures: a broker, and an OPC UA server that anybody may read; its nodes take a second to make."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.protocols.broker import Broker
    from tests.protocols.opcua import Running


@pytest.fixture(scope="session")
def _shared_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    from tests.protocols.opcua import Running

    one = Running(tmp_path_factory.mktemp("opcua"), security="none", anonymous_role="viewer", clients="any")
    one.plant.add(3)
    yield one
    one.server.close()


@pytest.fixture
def running(_shared_server: Running) -> Iterator[Running]:
    """Return the shared server; its plant has the same state again after the test."""
    before = _shared_server.plant.state
    yield _shared_server
    _shared_server.plant.state = before


@pytest.fixture(scope="session")
def operator(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the certificate of a client and its key."""
    from tests.protocols.opcua import make_certificate

    return make_certificate(tmp_path_factory.mktemp("client"), "operator")


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    """Start a broker."""
    from tests.protocols.broker import Broker

    folder = tmp_path / "broker"
    folder.mkdir()
    one = Broker(folder)
    one.start()
    yield one
    one.stop(kill=True)


@pytest.fixture
def short_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a publisher connect again sooner than in a plant."""
    from beltscape.protocols.mqtt import publisher

    monkeypatch.setattr(publisher, "_PAUSES_S", (0.1, 0.3))
