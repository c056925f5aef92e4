"""Keeps the operator's page open in a headless Chromium until standard input ends; saves a screenshot every minute.

python benchmarks/open_page.py http://127.0.0.1:8460/ page.png
"""

from __future__ import annotations

import sys
import threading
import time

from playwright.sync_api import Error, sync_playwright

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--enable-unsafe-swiftshader"]


def main(address: str, picture: str) -> None:
    """Open the page as soon as the server responds."""
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=FLAGS)
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        taken = time.monotonic()
        while not ended.is_set():
            try:
                if not page.url.startswith(address):  # blank page or Chromium's error page
                    page.goto(address)
                elif time.monotonic() - taken > 60:
                    taken = time.monotonic()
                    page.screenshot(path=picture)
            except Error:
                pass  # the server is not running; the page reconnects by itself
            page.wait_for_timeout(500)
        browser.close()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
