"""A running plant with its server, and pages of it in a real browser."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from beltscape.service.access.accounts import User
from beltscape.service.app import create_app
from beltscape.service.hosting import serve
from tests.service.feeder import PlantThread
from tests.service.plants import PASSWORD, make_service

CHROMIUM = Path("/usr/bin/chromium")
needs_chromium = pytest.mark.skipif(
    not CHROMIUM.exists(), reason="no /usr/bin/chromium (Debian's chromium package)"
)
ARGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--mute-audio"]
SOON_MS = 15_000
NO_WEBGL = """const get = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return kind.startsWith("webgl") ? null : get.call(this, kind, ...more);
};"""


class Site:
    """A running plant with its server, and browser pages on it."""

    def __init__(self, folder: Path, browser, *, frames: int = 8) -> None:
        self.browser = browser
        self.works = make_service(folder, full_m3_h=900.0, stale_s=1.5)
        self.works.access.accounts.add("ana", "operator", PASSWORD)
        self.works.access.accounts.add("eva", "engineer", PASSWORD)
        self.server = serve(self.works.app, self.works.settings)
        self.address = self.server.address
        for _ in range(frames):
            self.works.plant.step()
        self.running = PlantThread(self.works.plant)
        if not frames:
            self.running.paused.set()
        self.errors: list[str] = []
        self.foreign_requests: list[str] = []

    def page(
        self,
        path: str = "/",
        *,
        wide: int = 1300,
        high: int = 800,
        webgl: bool = False,
        user: str = "ana",
        **more,
    ):
        """Open a page, signed in; without WebGL by default, which is slow without a graphics card."""
        context = self.browser.new_context(
            viewport={"width": wide, "height": high}, locale="en-GB", reduced_motion="reduce", **more
        )
        context.set_default_timeout(SOON_MS)
        token = self.works.access.sessions.open(User(user, "operator"), "")
        context.add_cookies([{"name": "beltscape", "value": token, "url": self.address}])
        if not webgl:
            context.add_init_script(NO_WEBGL)
        page = context.new_page()
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on(
            "console", lambda message: self.errors.append(message.text) if message.type == "error" else None
        )
        page.on(
            "request",
            lambda request: (
                None
                if request.url.startswith((self.address, "data:", "blob:"))
                else self.foreign_requests.append(request.url)
            ),
        )
        page.goto(self.address + path)
        return page

    def stop(self) -> None:
        self.server.close()

    def restart(self, **more: Any) -> None:
        parts = self.works
        port = int(self.address.rsplit(":", 1)[1])
        again = parts.settings.model_copy(update={"port": port})
        self.server = serve(
            create_app(parts.live_state, parts.history, parts.access, parts.plant, again, **more), again
        )

    def close(self) -> None:
        self.running.close()
        self.server.close()
        self.works.history.close()


def wait_until_live(page) -> None:
    page.wait_for_selector("body[data-link=live]")


def wait_for(page, expression: str) -> None:
    """Wait until an expression is true; the content security policy forbids Playwright's own wait."""
    end_s = time.monotonic() + SOON_MS / 1000
    while not page.evaluate(expression):
        assert time.monotonic() < end_s, expression
        page.wait_for_timeout(50)


def read_text(page, selector: str) -> str:
    return page.inner_text(selector)


def wait_for_change(page, selector: str, before: str) -> None:
    wait_for(page, f"document.querySelector({selector!r}).innerText !== {before!r}")
