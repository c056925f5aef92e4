"""A commissioning served by a process of its own, which a test kills and starts again, and a hand at its page."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx

from beltscape.service.access import Access, User
from beltscape.service.settings import PageSettings
from tests.service.page.site import ARGS, CHROMIUM
from tests.service.plants import PASSWORD

_PROGRAM = """
import sys
from pathlib import Path
from beltscape.commissioning import staged_cameras, trial
trial.DEMO_FOLDER, staged_cameras.PERIOD_S = Path(sys.argv[1]), float(sys.argv[2])
from beltscape.cli.main import main
sys.exit(main(sys.argv[3:]))
"""
PATIENCE_S = 600.0
"""Longest wait: ten times what the slowest step takes on a machine that does nothing else."""


def wait(fits: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
    """Wait until something holds, and return it."""
    until = time.monotonic() + patience_s
    while not (found := fits()):
        assert time.monotonic() < until, f"it does not come to hold: {what}"
        time.sleep(0.05)
    return found


def list_children(process: int) -> list[int]:
    """Return the processes that one has begun and that have not ended."""
    files = Path(f"/proc/{process}/task").glob("*/children")
    return [int(word) for file in files for word in file.read_text().split()]


def is_running(process: int) -> bool:
    """Return whether a process has not ended; a zombie has."""
    with suppress(OSError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


class ServedPlant:
    """The page's server as a process, its state by its interface."""

    def __init__(self, folder: Path, demo: Path, period_s: float) -> None:
        self.folder, self._demo, self._period_s = folder, demo, period_s
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.address = f"http://127.0.0.1:{self.port}"
        (folder / "data").mkdir(parents=True)
        access = Access(folder / "data", PageSettings(port=self.port).access)
        access.accounts.add("eva", "engineer", PASSWORD)
        self.token = access.sessions.open(User("eva", "engineer"), "")
        access.close()
        self._client = httpx.Client(base_url=self.address, cookies={"beltscape": self.token}, timeout=60)
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Begin the process, and wait until it answers."""
        words = [
            str(self._demo),
            str(self._period_s),
            "commission",
            str(self.folder),
            "--port",
            str(self.port),
        ]
        self._process = subprocess.Popen([sys.executable, "-c", _PROGRAM, *words], stderr=subprocess.DEVNULL)
        wait(self._answers, "the server answers")

    def _answers(self) -> bool:
        with suppress(httpx.TransportError):
            return self._client.get("/api/commission").status_code == 200
        return False

    def kill(self) -> None:
        """Kill the process, which cannot tidy up; the commands that it began end by themselves."""
        assert self._process is not None
        commands = list_children(self._process.pid)
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()
        for command in commands:
            wait(lambda one=command: not is_running(one), "a command ends with its server", 60)

    def close(self) -> None:
        """End the process, if it runs."""
        self._client.close()
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    def read(self) -> dict[str, Any]:
        """Return the state that the page shows."""
        return self._client.get("/api/commission").json()

    def post(self, path: str, body: Mapping[str, Any] | None = None) -> None:
        """Send what a button of the page sends."""
        token = self._client.get("/api/access/state").json()["token"]
        answer = self._client.post(
            f"/api/commission/{path}", json=body or {}, headers={"x-beltscape-token": token}
        )
        assert answer.status_code == 200, answer.text

    def get_status(self, step: str) -> str:
        """Return how a step stands."""
        return next(one["status"] for one in self.read()["steps"] if one["name"] == step)

    def wait_for_command(self, step: str) -> None:
        """Wait until a step has begun a command, or is over."""
        assert self._process is not None
        process = self._process.pid
        wait(lambda: list_children(process) or self.get_status(step) != "running", f"{step} begins")

    def run_step(self, step: str) -> None:
        """Run a step to its end; its own line says why it fails."""
        self.post(f"run/{step}")
        wait(lambda: self.get_status(step) != "running", step)
        found = next(one for one in self.read()["steps"] if one["name"] == step)
        assert found["status"] == "done", (step, found["failure"])


class Keyboard:
    """A browser before the page, in which nothing but keys is used; it may be closed and opened again."""

    def __init__(self, playwright, plant: ServedPlant, **context: Any) -> None:
        self._plant, self._context = plant, context
        self.browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=ARGS)
        self.errors: list[str] = []
        self.page = self.open()

    def open(self, path: str = "/"):
        """Open the page in a new window, signed in."""
        context = self.browser.new_context(viewport={"width": 1300, "height": 900}, **self._context)
        context.add_cookies([{"name": "beltscape", "value": self._plant.token, "url": self._plant.address}])
        context.set_default_timeout(PATIENCE_S * 1000)
        self.page = context.new_page()
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(self._plant.address + path)
        self.page.wait_for_selector("body[data-link=live]")
        return self.page

    def close(self) -> None:
        """Close the window; the program goes on."""
        self.page.context.close()

    def press(self, selector: str, key: str = "Enter") -> None:
        """Walk to an element with the tabulator, and press a key there."""
        self.page.wait_for_selector(f"{selector}:not([disabled])")
        for _ in range(150):
            if self.page.evaluate("selector => document.activeElement.matches(selector)", selector):
                self.page.keyboard.press(key)
                return
            self.page.keyboard.press("Tab")
        raise AssertionError(f"the keyboard does not reach {selector}")

    def write(self, selector: str, text: str) -> None:
        """Walk to a field, and write into it."""
        self.press(selector, "Control+a")
        self.page.keyboard.type(text)

    def wait_for_step(self, name: str, status: str) -> None:
        """Wait until the list shows how a step stands."""
        self.page.wait_for_selector(f'#steps li[data-key="{name}"][data-status="{status}"]')


def count_views(folder: Path) -> int:
    """Return how many views of the board are on the disk."""
    return len({path.stem for path in (folder / "calibration").glob("*/*.png")})
