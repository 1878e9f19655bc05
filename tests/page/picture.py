"""``python -m tests.page.picture [FOLDER]``: take the pictures of docs/how-to/dashboard.md."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import Page

from tests.page.browser import TABLET, chromium, click, tabs
from tests.page.page_server import page_of_a_simulated_board

ROOT = Path(__file__).resolve().parents[2]


def take(folder: Path) -> None:
    """Fly the plan of sines, and take pictures of it."""

    def picture(page: Page, name: str) -> None:
        page.screenshot(path=folder / f"{name}.png")

    with (
        TemporaryDirectory() as logs,
        page_of_a_simulated_board(Path(logs)) as served,
        chromium() as browser,
        tabs(browser) as wide,
    ):
        page = wide.open(served.address.page)
        click(page, "text=Fly sine")
        page.wait_for_timeout(25_000)
        picture(page, "page")
        for name in ("parameters", "events", "link"):
            click(page, f"#tab-{name}")
            page.wait_for_timeout(300)
            picture(page, name)
        click(page, "#tab-fly")
        with tabs(browser, TABLET) as upright:
            tablet = upright.open(served.address.page)
            tablet.wait_for_timeout(3_000)
            click(tablet, "text=Ask for control")
            tablet.wait_for_timeout(500)
            picture(tablet, "tablet")
            picture(page, "asked")
            page.keyboard.press("Space")
            page.wait_for_timeout(1_500)
            picture(page, "stopped")


if __name__ == "__main__":
    take(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "figures")
