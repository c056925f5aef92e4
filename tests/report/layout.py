"""Requirements on reports, checked in their text and in a browser's layout."""

from __future__ import annotations

import re
from base64 import b64decode
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beltscape.files.images import decode_image

CHROMIUM = Path("/usr/bin/chromium")
needs_browser = pytest.mark.skipif(
    not CHROMIUM.exists(), reason="no /usr/bin/chromium (Debian's chromium package)"
)
LEAST_PX = 11.0
PHONE, DESK, PAPER = 390, 1400, 702
"""Widths, px; paper: A4 within its margins."""

_AXES = ("ink", "quiet", "grid", "paper", "ground", "line")
"""Roles of the palette that axes, grids and texts have."""

_TOO_WIDE = """() => [...document.querySelectorAll("body *")].filter(e => {
  const box = e.getBoundingClientRect();
  if (!box.width || box.right <= innerWidth + 1 && box.left >= -1) return false;
  for (let p = e.parentElement; p; p = p.parentElement)
    if (getComputedStyle(p).overflowX === "auto") return false;
  return true;
}).map(e => `${e.tagName}.${e.getAttribute("class")}: ${e.textContent.trim().slice(0, 40)}`)"""
_SMALL = """least => {
  const found = [];
  for (const text of document.querySelectorAll("svg text, svg tspan")) {
    const svg = text.ownerSVGElement, box = svg.getBoundingClientRect();
    if (!box.width || !text.textContent.trim()) continue;
    const px = parseFloat(getComputedStyle(text).fontSize) * box.width / svg.viewBox.baseVal.width;
    if (px < least - 0.01) found.push(`${px.toFixed(1)} px: ${text.textContent.trim()}`);
  }
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const e = walk.currentNode.parentElement;
    if (!walk.currentNode.data.trim() || e.closest("svg, script, style") || !e.getClientRects().length) continue;
    const px = parseFloat(getComputedStyle(e).fontSize);
    if (px < least - 0.01) found.push(`${px} px: ${walk.currentNode.data.trim().slice(0, 40)}`);
  }
  return found;
}"""
_CUT = """() => [...document.querySelectorAll("svg text")].filter(text => {
  const svg = text.ownerSVGElement.getBoundingClientRect(), box = text.getBoundingClientRect();
  return svg.width && (box.left < svg.left - 2 || box.right > svg.right + 2 || box.top < svg.top - 2
    || box.bottom > svg.bottom + 2);
}).map(text => text.textContent.trim())"""
_UNSEEN = """() => {
  const light = color => {
    const linear = v => (v /= 255) <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4;
    const [r, g, b] = color.match(/[\\d.]+/g).map(linear);
    return .2126 * r + .7152 * g + .0722 * b;
  };
  const paper = getComputedStyle(document.querySelector("section")).backgroundColor;
  const ground = light(paper === "rgba(0, 0, 0, 0)" ? "rgb(255, 255, 255)" : paper);
  const found = [];
  for (const e of document.querySelectorAll("svg text, section p, td, th, h2, figcaption, .label, .value, .note")) {
    if (!e.getClientRects().length || !e.textContent.trim() || e.closest(".body")) continue;
    const style = getComputedStyle(e), ink = light(e.ownerSVGElement ? style.fill : style.color);
    const contrast = (Math.max(ink, ground) + .05) / (Math.min(ink, ground) + .05);
    if (contrast < 4.4) found.push(`${contrast.toFixed(1)}: ${e.textContent.trim().slice(0, 40)}`);
  }
  return found;
}"""


def text_faults(page: str) -> list[str]:
    """Return what is wrong with a report's text."""
    faults = []
    if elsewhere := re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?(?:https?:)?//[^"')]*""", page):
        faults.append(f"loads from elsewhere: {elsewhere[:3]}")
    bare = len(re.findall("<table", page)) - len(
        re.findall(r'<div class="table scroll[^"]*"[^>]*><table', page)
    )
    if bare:
        faults.append(f"{bare} tables without a scroll container")
    if "prefers-color-scheme: dark" not in page or "@media print" not in page:
        faults.append("no dark or no print style")
    wide, narrow = (len(re.findall(f'class="scroll {form}"', page)) for form in ("wide", "narrow"))
    if wide != narrow:
        faults.append(f"{wide} wide charts, {narrow} narrow ones")
    known = set(re.findall(r"(--c-[\w-]+):", page))
    if unknown := set(re.findall(r"var\((--c-[\w-]+)\)", page)) - known:
        faults.append(f"colours without a value: {unknown}")
    for svg in re.findall(r"<svg .*?</svg>", page, re.DOTALL):
        if lost := set(re.findall(r'(?:url\(|href=")#([\w-]+)', svg)) - set(
            re.findall(r' id="([\w-]+)"', svg)
        ):
            faults.append(f"a chart refers to what is not in it: {lost}")
    charts = re.findall(r'class="scroll (?:wide|narrow)"[^>]*>(<svg .*?</svg>)', page, re.DOTALL)
    faults += [f"chart {k} shows nothing" for k, svg in enumerate(charts) if not _has_marks(svg)]
    pictures = re.findall(r"data:image/(?:png|jpeg|webp);base64,([A-Za-z0-9+/=]{2000,})", page)
    faults += [f"picture {k} is blank" for k, data in enumerate(pictures) if _is_blank(b64decode(data))]
    return faults


def _has_marks(svg: str) -> bool:
    """Return whether a chart has a picture, or something in a colour that is not the axes'."""
    colors = re.findall(r"(?:fill|stroke)(?:: ?|=\")(var\(--c-[\w-]+\)|#[0-9a-f]{6})", svg)
    return "<image" in svg or bool(set(colors) - {f"var(--c-{role})" for role in _AXES})


def _is_blank(data: bytes) -> bool:
    picture = decode_image(data, "picture of a page").reshape(-1)
    return bool((picture == np.bincount(picture).argmax()).mean() > 0.995)


@contextmanager
def browser() -> Generator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(
            executable_path=str(CHROMIUM), args=["--no-sandbox", "--disable-gpu", "--mute-audio"]
        )
        yield opened
        opened.close()


def layout_faults(opened, page_text: str) -> list[str]:
    """Return what a browser shows wrong: on a phone, on a desk, in the dark and on paper."""
    faults, asked = [], list[str]()
    page = opened.new_page(viewport={"width": PHONE, "height": 900})
    page.on("request", lambda request: asked.append(request.url))
    page.set_content(page_text)
    for width, scheme, media in (
        (PHONE, "light", "screen"), (PHONE, "dark", "screen"), (DESK, "light", "screen"), (PAPER, "dark", "print"),
    ):  # fmt: skip
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(media=media, color_scheme=scheme)
        where = f"{width} px, {scheme}, {media}"
        for what, found in (
            ("too wide", page.evaluate(_TOO_WIDE)),
            ("too small", page.evaluate(_SMALL, LEAST_PX) if media == "screen" else []),
            ("cut", page.evaluate(_CUT)),
            ("hardly seen", page.evaluate(_UNSEEN)),
        ):
            faults += [f"{where}: {what}: {one}" for one in found[:5]]
    page.close()
    return faults + [f"asks for: {url}" for url in asked if not url.startswith(("data:", "about:"))]
