"""A real browser without a window, for tests of pages; skips where there is none."""

import os
import shutil
from contextlib import contextmanager

import pytest

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
SOFTWARE = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@contextmanager
def opened_browser():
    """The browser, for as long as the context lasts."""
    playwright = pytest.importorskip("playwright.sync_api", reason="pages are tried with pip install playwright")
    path = next(filter(None, map(shutil.which, NAMES)), None)
    with playwright.sync_playwright() as running:
        if path is None and not os.path.exists(running.chromium.executable_path):
            pytest.skip(f"pages are tried in a browser, and none is installed ({NAMES[0]}, say)")
        browser = running.chromium.launch(executable_path=path, args=SOFTWARE)
        yield browser
        browser.close()


def troubles(page):
    """A list that fills with what goes wrong on a page, and with whatever it asks of the network."""
    found = []
    page.on("console", lambda message: found.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: found.append(str(error)))
    page.on(
        "request", lambda request: None if request.url.startswith(("data:", "file:")) else found.append(request.url)
    )
    return found
