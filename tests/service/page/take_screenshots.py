"""Takes the manual's pictures of the operator's page from a simulated plant: ``make screenshots``.

    python -m tests.service.page.take_screenshots [FOLDER] [--all]

``--all`` also takes every view on a desktop and on a phone, light and dark, in English and German, for a person to
look at.
"""

from __future__ import annotations

import argparse
import io
import tempfile
import time
from collections.abc import Generator
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from beltscape.core.alarms import Alarm
from beltscape.production.settings import ReportSettings, ScaleSettings
from beltscape.service.hosting import serve
from beltscape.service.production.figures import ProductionFigures
from beltscape.service.production.reports import ReportWriter
from tests.service.feeder import SimulatedPlant
from tests.service.page.site import ARGS, CHROMIUM, Site, wait_until_live
from tests.service.plants import ServiceParts, add_production
from tests.service.production.plants import HOUR_NS, make_control

IMAGES = Path(__file__).resolve().parents[3] / "docs" / "images"
HISTORY_S, STEP_S = 300, 0.2
SURFACE_MS = 8000
"""Time in which the browser has drawn the belt's surface without a graphics card."""
DESKTOP: dict[str, Any] = {"wide": 1440, "high": 1010}
WALL: dict[str, Any] = {"wide": 1920, "high": 1080}
PHONE: dict[str, Any] = {"wide": 360, "high": 740}
MOVING: dict[str, Any] = {"wide": 1280, "high": 900}
MOVING_SIZE, MOVING_FRAMES, MOVING_STEP_MS = (960, 675), 20, 300
"""Size of the animation for README, px, its number of frames, and the time between two."""
VIEWS = ("live", "production", "alarms-view", "history", "health", "health?settings")
"""Views by the part of the address behind #; the last one with the dialog of the changed settings."""


def raise_alarms(site: Site) -> None:
    """Raise an alarm, and have another one acknowledged."""
    now_ns = time.time_ns()
    alarms = (
        Alarm("misaligned_belt", "warning", "raised", 63.0, 50.0, "mm", now_ns - 90 * 10**9, priority="high"),
        Alarm(
            "low_coverage", "warning", "acknowledged", 52.0, 60.0, "%", now_ns - 30 * 60 * 10**9, by="ana",
            acknowledged_ns=now_ns - 25 * 60 * 10**9, group="images", is_first=True,
        ),
    )  # fmt: skip
    for alarm in alarms:
        site.works.plant.raise_alarm(alarm)


def write_history(works: ServiceParts) -> None:
    """Write the records of the last minutes, up to now; the plant goes on with them."""
    plant, past = works.plant, SimulatedPlant([], works.plant.ledger)
    wall_ns = time.time_ns() - HISTORY_S * 10**9
    while wall_ns < time.time_ns():
        past.step(wall_ns)
        wall_ns += round(STEP_S * 1e9)
    plant.number, plant.belt_mm, plant.done = past.number, past.belt_mm, past.done


@contextmanager
def run_plant(folder: Path, browser: Any) -> Generator[Site]:
    """Run a plant with five minutes of history, products, a batch, a report and alarms."""
    site = Site(folder, browser, frames=0)
    site.server.close()
    works = site.works
    works.settings = works.settings.model_copy(update={"plant": "Conveyor C4 · Quarry north"})
    works.live_state.set_settings(works.settings)
    figures = ProductionFigures(make_control(works.history), ScaleSettings())
    reports = ReportWriter(ReportSettings(), figures, works.history, folder, works.settings.plant, print)
    add_production(works, figures, reports)
    figures.control.start_batch("Truck 7", "", "ana")
    write_history(works)
    reports.write_due(time.time_ns() + 30 * HOUR_NS)
    raise_alarms(site)
    site.server = serve(works.app, works.settings)
    site.address = site.server.address
    site.running.paused.clear()
    try:
        yield site
    finally:
        site.close()


def open_view(site: Site, path: str, **options: Any) -> Page:
    """Return a page whose view has been drawn."""
    page = site.page(path, **options)
    wait_until_live(page)
    page.wait_for_timeout(SURFACE_MS if options.get("webgl") else 1500)
    return page


def take(site: Site, file: Path, path: str, **options: Any) -> None:
    """Write the picture of one view."""
    page = open_view(site, path, **options)
    page.screenshot(path=file)
    page.context.close()


def take_whole(site: Site, file: Path, path: str, **options: Any) -> None:
    """Write the picture of one view from its top to its end, as an engineer sees it."""
    view, dialog, _ = path.partition("?settings")
    page = open_view(site, view, user="eva", timezone_id="Europe/Berlin", **options)
    if dialog:
        page.click("#settings-open")
        page.wait_for_timeout(500)
    page.screenshot(path=file, full_page=True)
    page.context.close()


def take_phone(site: Site, file: Path) -> None:
    """Write two screens of a phone side by side: the top of the page, and one screen below it."""
    page = open_view(site, "/", webgl=True, has_touch=True, device_scale_factor=1.25, wide=390, high=840)
    screens = [page.screenshot()]
    page.evaluate("document.querySelector('#surface, canvas')?.closest('section')?.scrollIntoView()")
    page.wait_for_timeout(2000)
    screens.append(page.screenshot())
    page.context.close()
    pictures = [Image.open(io.BytesIO(one)).convert("RGB") for one in screens]
    gap = 24
    joined = Image.new("RGB", (sum(one.width for one in pictures) + gap, pictures[0].height), "white")
    for k, one in enumerate(pictures):
        joined.paste(one, (k * (one.width + gap), 0))
    joined.save(file, optimize=True)


def take_moving(site: Site, file: Path) -> None:
    """Write an animation of the page while the belt passes."""
    page = open_view(site, "/", webgl=True, **MOVING)
    frames: list[Image.Image] = []
    for _ in range(MOVING_FRAMES):
        picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        frames.append(picture.resize(MOVING_SIZE, Image.Resampling.LANCZOS))
        page.wait_for_timeout(MOVING_STEP_MS)
    page.context.close()
    frames[0].save(
        file, save_all=True, append_images=frames[1:], duration=MOVING_STEP_MS, loop=0, quality=55, method=6
    )


def take_all(site: Site, folder: Path) -> None:
    """Write every view in every form."""
    for view, theme, language in product(VIEWS, ("light", "dark"), ("en", "de")):
        path, name = f"/?theme={theme}&lang={language}#{view}", view.replace("?", "_")
        take_whole(site, folder / f"{name}_desktop_{theme}_{language}.png", path, **DESKTOP)
        take_whole(site, folder / f"{name}_phone_{theme}_{language}.png", path, has_touch=True, **PHONE)


def main() -> None:
    """Take the pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=IMAGES)
    parser.add_argument("--all", action="store_true")
    options = parser.parse_args()
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as data:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=ARGS)
        with run_plant(Path(data), browser) as site:
            take(site, options.folder / "operator_light.png", "/", webgl=True, **DESKTOP)
            take(site, options.folder / "operator_wall.png", "/?wall&theme=dark", webgl=True, **WALL)
            take_moving(site, options.folder / "passing.webp")
            take_phone(site, options.folder / "operator_phone.png")
            if options.all:
                take_all(site, options.folder)
        browser.close()


if __name__ == "__main__":
    main()
