"""The 3-D viewer in a browser, opened from a file without a network."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from beltscape.report.viewer import ViewerCloud, ViewerScene, render_viewer_page
from tests.optional import require
from tests.report.layout import CHROMIUM, needs_browser

pytestmark = [pytest.mark.browser, needs_browser]
SIDE = 60
Shoot = Callable[[], np.ndarray]


def make_scene() -> ViewerScene:
    """A red plate of 600 × 600 mm at z = 0, and a blue one in its place in a second frame; a belt and a camera."""
    x, y = np.meshgrid(np.linspace(-300, 300, SIDE), np.linspace(-300, 300, SIDE))
    points = np.stack([x, y, 0.02 * x], -1).reshape(-1, 3)
    normals = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    sigmas = np.full(len(points), 0.1)
    clouds = [
        ViewerCloud(name, points, normals, np.full(points.shape, color, np.uint8), sigmas)
        for name, color in (("000", (250, 20, 20)), ("001", (20, 20, 250)))
    ]
    triangle = np.array([[[-300.0, -300, -40], [300, -300, -40], [0, 300, -40]]])
    line = np.array([[0.0, 0, 300], [0, 0, 500]])
    label = np.array([0.0, 0, 300])
    return ViewerScene(
        "plate", "test", clouds, [("cameras", "#1971c2", line)], [("belt", "#748ffc", triangle)],
        [("cameras", "cam0", label)],
    )  # fmt: skip


def count_color(picture: np.ndarray, channel: int) -> int:
    """Return the number of pixels in which one channel (RGB) outshines the others; the panels are left out."""
    view = picture[60:520, 330:].astype(int)
    rest = np.delete(view, channel, axis=2).max(axis=2)
    return int((view[..., channel] - rest > 90).sum())


@pytest.fixture(scope="module")
def viewer_page(tmp_path_factory):
    from playwright.sync_api import sync_playwright

    path = tmp_path_factory.mktemp("viewer") / "scene.html"
    path.write_text(render_viewer_page(make_scene()), encoding="utf-8")
    words = ["--no-sandbox", "--mute-audio", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=str(CHROMIUM), args=words)
        page = opened.new_page(viewport={"width": 900, "height": 600}, color_scheme="dark")
        troubles: list[str] = []
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.on("console", lambda line: troubles.append(line.text) if line.type == "error" else None)
        page.on("request", lambda request: troubles.append(request.url) if "http" in request.url else None)
        page.goto(path.as_uri())
        page.wait_for_selector("#colours button")
        yield page, troubles
        opened.close()


@pytest.fixture
def shoot(viewer_page) -> Shoot:
    page, _ = viewer_page

    def take() -> np.ndarray:
        page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        encoded = np.frombuffer(page.screenshot(), np.uint8)
        return np.asarray(require(cv2.imdecode(encoded, cv2.IMREAD_COLOR)))[..., ::-1]

    return take


def test_frames_colours_layers_and_sides_are_drawn(viewer_page, shoot):
    page, troubles = viewer_page
    page.click("text=colour")
    page.click("button[data-side=top]")
    first = shoot()
    assert count_color(first, 0) > 20_000  # the red plate from above
    page.fill("#frame", "1")
    assert count_color(shoot(), 0) < 500 and count_color(shoot(), 2) > 20_000
    page.fill("#frame", "0")
    np.testing.assert_array_equal(shoot(), first)
    page.click("#layers >> text=cloud")
    assert count_color(shoot(), 0) < 500
    page.click("#layers >> text=cloud")
    page.click("button[data-side=front]")
    assert 500 < count_color(shoot(), 0) < 0.5 * count_color(first, 0)  # a plate from the side is narrow
    assert troubles == []


def test_dragging_turns_and_home_returns(viewer_page, shoot):
    page, troubles = viewer_page
    page.click("text=colour")
    page.click("button[data-side=home]")
    home = shoot()
    page.mouse.move(600, 300)
    page.mouse.down()
    page.mouse.move(720, 340)
    page.mouse.up()
    assert np.abs(shoot().astype(int) - home).max() > 100
    page.mouse.dblclick(600, 300)
    page.click("button[data-side=home]")
    page.mouse.move(5, 590)
    assert np.abs(shoot().astype(int) - home).mean() < 0.5
    assert troubles == []


def test_the_ground_follows_the_screens_scheme(viewer_page, shoot):
    page, _ = viewer_page
    page.emulate_media(color_scheme="dark")
    dark = shoot()[300, 890]
    page.emulate_media(color_scheme="light")
    light = shoot()[300, 890]
    page.emulate_media(color_scheme="dark")
    assert dark.max() < 60 and light.min() > 200
