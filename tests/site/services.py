"""Real services for the tests of a site: each with its own port, which can be stopped and started again."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from beltscape.service.app import create_app
from beltscape.service.hosting import RunningServer, serve
from beltscape.site.run import RunningSite, serve_site
from beltscape.site.settings import read_site
from tests.protocols.broker import find_port
from tests.service.plants import ServiceParts, make_service


@dataclass
class Belt:
    """A service with its own port, which can be stopped and started again."""

    folder: Path
    parts: ServiceParts
    key: str
    port: int = field(default_factory=find_port)
    server: RunningServer | None = None
    tls: dict[str, Path] = field(default_factory=dict)

    def start(self) -> None:
        parts = self.parts
        web = parts.settings.model_copy(update={"port": self.port, **self.tls})
        app = create_app(parts.live_state, parts.history, parts.access, parts.plant, web)
        self.server = serve(app, web)

    def stop(self) -> None:
        if self.server is not None:
            self.server.close()
            self.server = None

    def measure(self, records: int) -> None:
        for _ in range(records):
            self.parts.plant.step()


@contextmanager
def serve_belts(folder: Path, names: str) -> Generator[dict[str, Belt]]:
    """Yield belts that answer; each name is a letter."""
    made: dict[str, Belt] = {}
    for name in names:
        parts = make_service(folder / name, stale_s=600.0)  # nothing measures between the steps
        made[name] = Belt(folder / name, parts, parts.access.keys.create("site"))
        made[name].start()
    yield made
    for belt in made.values():
        belt.stop()
        belt.parts.access.close()
        belt.parts.history.close()


def write_site(folder: Path, belts: dict[str, Belt], lines: str = "", away_s: float = 1, **urls: str) -> Path:
    """Write a site.toml."""
    text = f'poll_s = 0.2\naway_s = {away_s}\n{lines}\n[web]\nport = 0\nplant = "Quarry"\n'
    for name, belt in belts.items():
        (folder / f"{name}.key").write_text(belt.key + "\n")
        url = urls.get(name, f"http://127.0.0.1:{belt.port}")
        text += f'[[belts]]\nname = "{name}"\nurl = "{url}"\nkey_file = "{name}.key"\n'
    path = folder / "site.toml"
    path.write_text(text)
    return path


@contextmanager
def run(path: Path) -> Generator[tuple[RunningSite, Callable[[str], dict[str, Any]]]]:
    """Run a site; yield it and a function that gives what the page shows of a belt."""
    with ExitStack() as stack:
        running = stack.enter_context(serve_site(read_site(path)))

        def show(name: str) -> dict[str, Any]:
            return next(belt for belt in running.state.take_snapshot()["belts"] if belt["name"] == name)

        yield running, show
