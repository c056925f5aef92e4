"""A whole application with a history of some seconds, for tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import httpx
from fastapi import FastAPI

from beltscape.service.access import Access, AccessSettings
from beltscape.service.app import create_app
from beltscape.service.live_state import LiveState
from beltscape.service.settings import WebSettings
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from service.access.door import CHEAP, PASSWORD, Browser
from service.feeder import Plant

BEGIN_NS = 1_790_000_000_000_000_000
STEP_NS = 200_000_000


@dataclass
class Works:
    """All that belongs together."""

    live_state: LiveState
    history: Historian
    access: Access
    plant: Plant
    settings: WebSettings
    app: FastAPI

    def browser(self, role: str = "") -> Callable[..., httpx.Response]:
        """Somebody of that role; "": whoever has not signed in."""
        browser = Browser(self.app, "127.0.0.1")
        if role:
            self.access.accounts.add(f"the-{role}", role, PASSWORD)
            assert browser.log_in(f"the-{role}").status_code == 200
        return browser


def works(folder: Path, frames: int = 0, **settings) -> Works:
    """A plant that measured so many frames, its history, and the application."""
    web = WebSettings(**{"port": 0, "plant": "Belt 7", "page_rate_hz": 10.0, **settings})
    live_state, history = LiveState(web), Historian(folder, HistorySettings())
    history.begin_run()
    access = Access(folder, web.access, CHEAP)
    plant = Plant([live_state], history)
    for k in range(frames):
        plant.step(BEGIN_NS + k * STEP_NS)
    return Works(live_state, history, access, plant, web, create_app(live_state, history, access, plant, web))


OPEN = AccessSettings(anonymous_role="viewer")
