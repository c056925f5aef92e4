"""The thread of a server: it says when it listens, refuses a taken port, and survives one that is taken later."""

from __future__ import annotations

import asyncio
import threading

import pytest

from beltscape.core import supervision
from beltscape.core.errors import InputError
from beltscape.protocols.listening import ListeningThread


def test_an_address_that_cannot_be_listened_on_is_refused() -> None:
    async def serve() -> None:
        await asyncio.sleep(0)
        listening.fail(OSError("address in use"))

    listening = ListeningThread("modbus", serve, lambda _: None, 5)
    with pytest.raises(InputError, match=r"\[modbus\]: here port 502 .*address in use.*; choose another"):
        listening.start("here", 502, "choose another")
    listening.close(5)


def test_a_port_that_is_taken_while_it_restarts_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervision, "RESTART_S", 0.01)
    messages: list[str] = []
    starts: list[int] = []
    is_back = threading.Event()

    async def serve() -> None:
        starts.append(len(starts))
        if len(starts) == 2:
            listening.fail(OSError("address in use"))
            return
        listening.confirm()
        if len(starts) == 1:
            raise ValueError("a fault")
        is_back.set()
        while not listening.is_stopped:
            await asyncio.sleep(0.01)

    listening = ListeningThread("opcua", serve, messages.append, 5)
    listening.start("here", 4840, "choose another")
    assert is_back.wait(20)
    assert len(starts) == 3
    assert messages == [
        "opcua: ValueError: a fault; it starts again",
        "opcua: OSError: address in use; it starts again",
    ]
    listening.close(5)
