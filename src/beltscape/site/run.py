"""The run of a site: followers of all belts, balances and the page, until it is stopped."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from threading import Event
from typing import Any

from beltscape.core.errors import InputError, OutputError
from beltscape.core.supervision import make_supervised_thread
from beltscape.core.system_calls import notify
from beltscape.service.access import Access
from beltscape.service.hosting import RunningServer, check_listening, serve
from beltscape.site.app import SiteState, create_site_app
from beltscape.site.balancing import Balancer
from beltscape.site.client import BeltClient, BeltFaultError
from beltscape.site.follower import BeltFollower
from beltscape.site.settings import Site
from beltscape.site.store import SiteStore

_BALANCE_S = 1.0
"""Period at which balances are brought up to date."""
_PRUNE_S = 3600.0
"""Period at which old sums by seconds are removed."""
_LOG = logging.getLogger("beltscape.site")


@dataclass(frozen=True, slots=True)
class RunningSite:
    """A site that runs."""

    server: RunningServer
    state: SiteState


@contextmanager
def serve_site(site: Site) -> Generator[RunningSite]:
    """Follow the belts and serve the page until the end of the context.

    Raises
    ------
    InputError, SettingsError, OutputError
        With one line that names the fault and the fix.
    """
    settings = site.settings
    check_listening(settings.web)
    try:
        site.data.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{site.data}: cannot be created ({error})") from error
    with ExitStack() as running:
        store = SiteStore(site.data)
        running.callback(store.close)
        followers = [BeltFollower(settings, belt, store, _LOG.warning) for belt in settings.belts]
        state = SiteState(settings, followers, store)
        access = Access(site.data, settings.web.access)
        running.callback(access.close)
        for follower in followers:
            follower.start()
            running.callback(follower.close)
        running.enter_context(_keep_balances(site, state, store))
        server = serve(create_site_app(state, access), settings.web)
        running.callback(server.close)
        yield RunningSite(server, state)


@contextmanager
def _keep_balances(site: Site, state: SiteState, store: SiteStore) -> Generator[None]:
    """Balance the windows of all transfer points as they close, in a thread."""
    stop = Event()
    balancers = [Balancer(site.settings, balance, store) for balance in site.settings.balances]

    def keep() -> None:
        pruned_s = 0.0
        while not stop.wait(_BALANCE_S):
            now_s = time.time()
            now_ms = round(now_s * 1000)
            for alarm in state.update([balancer.update(now_ms) for balancer in balancers], now_ms):
                _LOG.warning("alarm: %s: %s", alarm.subject, alarm.kind)
            if now_s - pruned_s > _PRUNE_S:
                pruned_s = now_s
                store.prune(round(now_s - (site.settings.keep_days + 1) * 86_400))

    thread = make_supervised_thread(
        "site-balances", keep, lambda failure: _LOG.error("%s", failure), stop.wait
    )
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(3.0)


def run_site(site: Site, stop: Event) -> dict[str, Any]:
    """Serve a site until ``stop`` is set; return a summary."""
    with serve_site(site) as running:
        notify("READY=1")
        for warning in running.server.warnings:
            _LOG.warning("%s", warning)
        _LOG.info("following %d belts; the page is at %s", len(site.settings.belts), running.server.address)
        stop.wait()
        notify("STOPPING=1")
    return {"site": site.path, "data": site.data, "belts": [belt.name for belt in site.settings.belts]}


def check_site(site: Site, warn: Callable[[str], None] = lambda _: None) -> dict[str, str]:
    """Return one line for each belt and for the page; ``warn`` receives those of belts that cannot be read.

    Raises
    ------
    InputError
        If no belt can be read.
    SettingsError
        If the page cannot be served.
    """
    lines: dict[str, str] = {}
    faults: list[str] = []
    for belt in site.settings.belts:
        client = BeltClient(belt)
        try:
            page, state = client.read_page(), client.read_state()
            lines[belt.name] = f"{belt.url}, version {page.version}, {state.totals.records} records"
        except BeltFaultError as error:
            lines[belt.name] = error.fault.text
            faults.append(f"{belt.name}: {error.fault.text}")
        finally:
            client.close()
    if len(faults) == len(site.settings.belts):
        raise InputError(f"{site.path}: no belt can be read; {'; '.join(faults)}")
    for fault in faults:
        warn(fault)
    check_listening(site.settings.web)
    lines["page"] = f"{site.settings.web.host} port {site.settings.web.port}"
    return lines
