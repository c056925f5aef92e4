"""Keeps the operator's page open in a headless Chromium until standard input ends: a picture of it every minute.

python benchmarks/open_page.py http://127.0.0.1:8460/ page.png
"""

from __future__ import annotations

import sys
import threading
import time

from playwright.sync_api import Error, sync_playwright

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--enable-unsafe-swiftshader"]


def main(address: str, picture: str) -> None:
    """Open it as soon as it answers."""
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=FLAGS)
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        taken = time.monotonic()
        while not ended.is_set():
            try:
                if not page.url.startswith(address):  # blank, or Chromium's own page of an error
                    page.goto(address)
                elif time.monotonic() - taken > 60:
                    taken = time.monotonic()
                    page.screenshot(path=picture)
            except Error:
                pass  # it is not there yet, or was killed: the page itself comes back
            page.wait_for_timeout(500)
        browser.close()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
