"""A certificate that does not hold any more: alarms of a running plant on page, broker, syslog server and in the log.

The plant runs as `beltscape run` does, with its page, a broker and a syslog server; the operator uses a browser.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread

import pytest

from beltscape.core.progress import Silent
from beltscape.pipeline.certifying.certificates import IssueOptions, issue_certificate
from beltscape.pipeline.certifying.material_test import EvaluatedTest, evaluate_test_file
from beltscape.pipeline.live.assembly import RunOptions
from beltscape.pipeline.live.measuring_parts import describe_provenance
from beltscape.service.access import Access
from beltscape.service.plant import run_plant
from beltscape.service.project import open_project
from tests.pipeline.certifying.plants import make_tested_plant
from tests.pipeline.live.conftest import PROJECT
from tests.protocols.broker import Broker, Subscriber, wait_until, with_broker
from tests.protocols.syslog_server import Server
from tests.service.access.sample_app import CHEAP, PASSWORD
from tests.service.page.site import ARGS, CHROMIUM, NO_WEBGL, needs_chromium

pytestmark = [needs_chromium, pytest.mark.browser]
TOPIC = "plant/belt"
DUE, VOID = "material_test_due", "test_certificate_void"
DAY_MS = 86_400_000
PATIENCE_S = 120.0
"""Longest wait: a hundred times what an alarm takes on a machine that does nothing else."""


class WatchedPlant:
    """A running plant with everything that shows its alarms."""

    def __init__(self, path: Path, evaluated: EvaluatedTest, caplog: pytest.LogCaptureFixture) -> None:
        self.path, self.data, self.caplog = path, path.parent / "data", caplog
        self._evaluated = evaluated
        self._stop = Event()
        self._broker, self._syslog = Broker(path.parent), Server("udp")
        self._broker.start()
        self._failure: list[BaseException] = []
        path.write_text(
            PROJECT.replace("[encoder]", "loop = true\n[encoder]")
            + f'[mqtt]\nhost = "127.0.0.1"\nport = {self._broker.port}\ntopic = "{TOPIC}"\nstate_every_s = 0.2\n'
            f'[syslog]\nhost = "127.0.0.1"\nport = {self._syslog.port}\ntransport = "udp"\n'
            f"[alarms.{DUE}]\nclear_after_s = 0\n[alarms.{VOID}]\nclear_after_s = 0\n"
        )
        access = Access(self.data, open_project(path).settings.web.access, CHEAP)
        access.accounts.add("ana", "operator", PASSWORD)
        access.close()
        self.subscriber = Subscriber(self._broker.port, TOPIC)
        self._thread = Thread(target=self._run, name="plant", daemon=True)

    def issue(self, now_ms: int | None = None, **applies: str) -> None:
        """Issue a certificate for the plant as it is, or with other parts that it ``applies`` to."""
        present = {**describe_provenance(open_project(self.path)), **applies}
        evaluated = replace(self._evaluated, document={**self._evaluated.document, "applies": present})
        now_ms = time.time_ns() // 1_000_000 if now_ms is None else now_ms
        issue_certificate(self.data, evaluated, IssueOptions("belt 4", "meier", now_ms, valid_days=365))

    def start(self) -> str:
        """Begin to measure; return the page's address."""
        self._thread.start()
        wait_until(lambda: bool(self._failure or self._find_address()), PATIENCE_S)
        assert self._failure == []
        return self._find_address()

    def _run(self) -> None:
        try:
            run_plant(open_project(self.path), RunOptions(self.data), self._stop, page=True)
        except BaseException as error:  # the test must not wait for a plant that has ended
            self._failure.append(error)

    def _find_address(self) -> str:
        found = re.search(r"the page is at (\S+)", self.caplog.text)
        return found[1] if found else ""

    def find_logged(self, name: str, state: str) -> list[str]:
        """Return the lines of the log about an alarm that came into a state."""
        return [line for line in self.caplog.messages if line.startswith(f"alarm {name} {state}")]

    def find_sent(self, name: str, state: str) -> list[str]:
        """Return the texts that came to the syslog server about an alarm that came into a state."""
        return [one.text for one in self._syslog.received if one.text.startswith(f"{name} {state}")]

    def close(self) -> None:
        """End everything; the plant must have ended in order."""
        self._stop.set()
        self._thread.join(PATIENCE_S)
        self.subscriber.close()
        self._broker.stop()
        self._syslog.close()
        assert not self._thread.is_alive() and self._failure == []


@pytest.fixture
def watched(plant: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> Iterator[WatchedPlant]:
    """A plant that looks at its alarms often; it is not started yet."""
    caplog.set_level(logging.INFO, "beltscape")
    times = "".join(f"{number:03d},{3 * number},5000\n" for number in range(2))
    (plant.parent / "belt" / "encoder.csv").write_text(f"frame,timestamp_s,belt_position_mm\n{times}")
    tested, path = make_tested_plant(tmp_path / "tested")
    one = WatchedPlant(plant, evaluate_test_file(path, open_project(tested.path), Silent()), caplog)
    yield one
    one.close()


class Operator:
    """An operator at the page."""

    def __init__(self, page, watched: WatchedPlant) -> None:
        self.page, self.watched = page, watched

    def sign_in(self, address: str) -> None:
        """Sign in as people do."""
        self.page.goto(f"{address}/login")
        self.page.wait_for_selector("button.primary:enabled")  # before, the page takes no Enter
        self.page.fill("input[name=name]", "ana")
        self.page.fill("input[name=password]", PASSWORD)
        self.page.press("input[name=password]", "Enter")
        self.page.wait_for_selector("body[data-link=live]")

    def expect(self, name: str, *words: str) -> None:
        """Expect an alarm on page, broker, syslog and log, each time with these words."""
        card = self.page.locator(f".alarm[data-key='{name}']")
        self.page.wait_for_selector(f".alarm[data-key='{name}'][data-state=raised]")
        wait_until(lambda: (self.watched.subscriber.last(f"alarms/{name}") or {}).get("state") == "raised")
        wait_until(lambda: bool(self.watched.find_sent(name, "raised")))
        published = self.watched.subscriber.last(f"alarms/{name}")["detail"]
        newest = [self.watched.find_sent(name, "raised")[-1], self.watched.find_logged(name, "raised")[-1]]
        for text in (card.inner_text(), published, *newest):
            for word in words:
                assert word in text.lower()

    def acknowledge_what_is_gone(self, name: str) -> None:
        """Acknowledge an alarm whose cause has ended: it leaves every list."""
        self.page.wait_for_selector(f".alarm[data-key='{name}'][data-state=gone]")
        self.page.click(f".alarm[data-key='{name}'] button.acknowledge:visible")
        self.page.wait_for_selector(f".alarm[data-key='{name}']", state="detached")
        wait_until(lambda: self.watched.subscriber.last(f"alarms/{name}")["state"] == "clear")
        assert self.watched.find_logged(name, "gone") and self.watched.find_logged(name, "clear")
        assert self.watched.find_sent(name, "gone") and self.watched.find_sent(name, "clear")


@with_broker
def test_an_overdue_certificate_and_every_change_is_named_everywhere_and_clears(watched, run) -> None:
    from playwright.sync_api import sync_playwright

    watched.issue(time.time_ns() // 1_000_000 - 400 * DAY_MS)
    with sync_playwright() as playwright, closing(
        playwright.chromium.launch(executable_path=str(CHROMIUM), args=ARGS)
    ) as browser:  # fmt: skip
        page = browser.new_context(locale="en-GB", viewport={"width": 1300, "height": 800}).new_page()
        page.set_default_timeout(PATIENCE_S * 1000)
        page.add_init_script(NO_WEBGL)
        operator = Operator(page, watched)
        operator.sign_in(watched.start())
        operator.expect(DUE, "overdue by 35 days")
        assert page.locator(f".alarm[data-key='{VOID}']").count() == 0
        watched.issue()
        operator.acknowledge_what_is_gone(DUE)
        number = sorted((watched.data / "certificates").glob("*.json"))[-1].stem
        for change, words in list_changes(watched.path.parent):
            undo = change()
            assert run("reload", watched.path)[0] == 0
            operator.expect(VOID, words, f"certificate {number}")
            undo()
            assert run("reload", watched.path)[0] == 0
            operator.acknowledge_what_is_gone(VOID)
        watched.issue(program="0.0.1")
        operator.expect(VOID, "the program's version has changed")
        watched.issue()
        operator.acknowledge_what_is_gone(VOID)
        assert page.locator(f".alarm[data-key='{DUE}']").count() == 0


def list_changes(folder: Path) -> list[tuple[Callable[[], Callable[[], object]], str]]:
    """Return what may change below a running plant, with what its alarm says; a change returns what undoes it."""

    def rewrite(name: str, make: Callable[[bytes], bytes]) -> Callable[[], Callable[[], object]]:
        path = folder / name

        def change() -> Callable[[], object]:
            before = path.read_bytes()
            path.write_bytes(make(before))
            return lambda: path.write_bytes(before)

        return change

    return [
        (rewrite("rig.json", lambda text: text.replace(b"}", b"} ", 1)), "the rig has changed"),
        (rewrite("empty/depth.tiff", lambda data: data + bytes(1)), "the empty belt has changed"),
        (
            rewrite("project.toml", lambda text: text.replace(b"load_mm = 150", b"load_mm = 160")),
            "settings of measuring have changed",
        ),
    ]
