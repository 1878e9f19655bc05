"""Chromium for tests, where the system has one: it draws in software, and reaches this machine only."""

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from heli_host.declaration import Channel

pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make setup")

from playwright.sync_api import Browser, BrowserContext, Page, Route, expect, sync_playwright

NAMES = ("chromium", "chromium-browser", "google-chrome")
PATIENCE_S = 90.0
expect.set_options(timeout=PATIENCE_S * 1e3)
WIDE, TABLET, PHONE, PROJECTOR = (1280, 720), (800, 1200), (390, 844), (1920, 1080)
SELDOM_DRAWN = """
const drawn = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (draw) => setTimeout(() => drawn(draw), 200);
"""
"""Sixty pictures a second are drawn in software, at a cost, and no claim is about their number."""
FLAGS = [
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    # Only the rig needs the software GPU. With it, putting pages together took half of Chromium's time.
    "--disable-gpu-compositing",
    "--disable-background-networking",
    "--disable-component-update",
    # Root may not use its sandbox; what it opens here is our own page.
    "--no-sandbox",
    "--disable-dev-shm-usage",
]


def find_browser() -> str | None:
    """The system's Chromium: what HELI_BROWSER says, or the first that is installed."""
    given = os.environ.get("HELI_BROWSER")
    return given or next((path for name in NAMES if (path := shutil.which(name))), None)


@contextmanager
def chromium() -> Iterator[Browser]:
    """Start it; skips where there is none."""
    path = find_browser()
    if path is None:
        pytest.skip("skipped: no Chromium: apt-get install chromium, or name one in HELI_BROWSER")
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=path, args=FLAGS)
        try:
            yield browser
        finally:
            browser.close()


def latest(channel: Channel) -> str:
    """Return the JavaScript expression for the newest value of a channel, in its unit."""
    return f"heliPage.history.latest({int(channel)})"


def until(page: Page, expression: str) -> None:
    """Wait until an expression of JavaScript is true. Playwright's own wait needs what the page's policy
    refuses."""
    end_s = time.monotonic() + PATIENCE_S
    while not page.evaluate(expression):
        assert time.monotonic() < end_s, f"waited in vain for {expression}"
        page.wait_for_timeout(30)


def click(page: Page, selector: str) -> None:
    """Click what is enabled. Playwright's own click waits for drawn frames, which a busy computer makes
    rare."""
    element = page.locator(selector).first
    expect(element).to_be_enabled(timeout=PATIENCE_S * 1e3)
    element.click(force=True)


def save_log(page: Page, log: Path) -> None:
    """Wait until the page that flies by itself has a log, and save the newest as a user does."""
    until(page, "Boolean(document.querySelector('.lab-save'))")
    click(page, "#tab-lab")
    with page.expect_download(timeout=PATIENCE_S * 1e3) as download:
        click(page, ".lab-save")
    download.value.save_as(log)


@dataclass
class Tabs:
    """Tabs, and everything that went wrong in them."""

    context: BrowserContext
    wrong: list[str] = field(default_factory=list)
    pages: list[Page] = field(default_factory=list)

    def open(self, url: str) -> Page:
        """Open a tab and wait until it knows who flies."""
        page = self.context.new_page()
        self.pages.append(page)
        page.on("pageerror", lambda error: self.wrong.append(f"error: {error}"))
        page.on(
            "requestfailed",
            lambda request: (
                self.wrong.append(f"failed: {request.url}")
                if request.url.startswith(("http", "ws"))
                else None
            ),
        )
        page.on(
            "console",
            lambda message: (
                self.wrong.append(f"console: {message.text}") if message.type == "error" else None
            ),
        )
        page.on(
            "response",
            lambda answer: (
                self.wrong.append(f"{answer.status}: {answer.url}") if answer.status >= 400 else None
            ),
        )
        page.goto(url)
        until(page, "Boolean(window.heliPage?.status && document.querySelector('#control').textContent)")
        return page

    def _guard(self, route: Route) -> None:
        address = urlsplit(route.request.url)
        if address.scheme in ("file", "blob") or address.hostname in ("127.0.0.1", "localhost"):
            route.continue_()
        else:
            self.wrong.append(f"left this machine: {route.request.url}")
            route.abort()


@contextmanager
def tabs(browser: Browser, size: tuple[int, int] = WIDE, offline: bool = False) -> Iterator[Tabs]:
    """Tabs of one window, closed at the end; offline, only files can be opened."""
    with ExitStack() as stack:
        context = browser.new_context(viewport={"width": size[0], "height": size[1]}, offline=offline)
        stack.callback(context.close)
        opened = Tabs(context)
        context.route("**/*", opened._guard)
        context.add_init_script(SELDOM_DRAWN)
        context.set_default_timeout(60_000)
        yield opened
