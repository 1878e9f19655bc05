"""``python -m tests.page.picture [FOLDER]``: take the pictures of docs/how-to/dashboard.md."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import Page

from tests.page.browser import TABLET, chromium, click, tabs
from tests.page.page_server import page_of_a_simulated_board

ROOT = Path(__file__).resolve().parents[2]
HELD = """
const drawn = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (draw) => drawn((nowMs) => {
  if (window.held) window.goOn = () => draw(nowMs); else draw(nowMs);
});
"""
"""The page draws nothing while `held` is true."""

AGREES = """
() => {
  // Without the name of the axis, or the time.
  const numbers = (row, cells) =>
    [...row.querySelectorAll(cells)].slice(1).map((cell) => parseFloat(cell.innerText));
  const table = [...document.querySelectorAll("#numbers tbody tr")].map((row) => numbers(row, "td, th"));
  const strips = [...document.querySelectorAll("#strips .u-legend")].map((row) => numbers(row, ".u-value"));
  const same = table.every((row, i) => row.every((value, j) => Math.abs(value - strips[i][j]) < 0.06));
  return window.held = same && table.every(([measured, setpoint]) => Math.abs(measured - setpoint) < 0.5);
}
"""
"""Strips and table show the same moment, at which each angle is within half a degree of its setpoint."""


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
        page.evaluate(HELD)
        click(page, "text=Fly sine")
        page.wait_for_timeout(25_000)
        page.wait_for_function(AGREES)
        picture(page, "page")
        page.wait_for_function("() => { window.held = false; return window.goOn; }")
        page.evaluate("window.goOn()")
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
