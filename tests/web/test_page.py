"""The page in Chromium, from a file and with the network off: flown, stopped, saved, replayed, attacked."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from heli_host.data.log.blind import SEALED, Truth, truth_path
from heli_host.data.log.reader import read_log
from heli_web.build import write_page

from tests.page import browser as browsers

pytest.importorskip("axe_playwright_python", reason="axe-playwright-python is not installed: make setup")

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from tests.page.browser import PATIENCE_S, PHONE, SELDOM_DRAWN, WIDE, click, until
from tests.running.order import REAL_TIME

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group(REAL_TIME)]

HIDE = """hidden => {
  Object.defineProperty(document, "hidden", {value: hidden, configurable: true});
  document.dispatchEvent(new Event("visibilitychange"));
}"""
READY = "Boolean(window.heliPage?.status && heliPage.history?.end)"
TABS = ("fly", "parameters", "events", "link", "lab")
MAX_BYTES = 1_500_000
HOSTILE_ADDRESSES = (
    "rig=../../etc/passwd", "rig=", "board=real", "seed=-1", "seed=1e99", "seed=NaN", "speed=1e9",
    "plan=<script>", "effect=nothing", "effect=rotor_lag,s:1e9", "effect=rotor_lag,q:1", "effect=x,s:",
    "set=travel_kp:1e30", "set=__proto__:1", "nonsense=1", "%00%ff%", "a" * 5000,
)  # fmt: skip


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browsers.chromium() as started:
        yield started


@contextmanager
def opened(browser: Browser, page: Path, address: str = "", size: tuple[int, int] = WIDE) -> Iterator[Page]:
    """Open the page in a window without a network. An error in it, or a request, fails the test."""
    context = browser.new_context(viewport={"width": size[0], "height": size[1]}, offline=True)
    context.add_init_script(SELDOM_DRAWN)
    tab, wrong = context.new_page(), []
    tab.on("pageerror", lambda error: wrong.append(f"error: {error}"))
    tab.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    tab.on(
        "request",
        lambda request: wrong.append(request.url) if request.url.startswith(("http", "ws")) else None,
    )
    tab.goto(f"{page.as_uri()}{'#' if address else ''}{address}")
    until(tab, READY)
    yield tab
    context.close()
    assert not wrong, "\n".join(wrong)


def save_log(tab: Page, log: Path) -> None:
    """Wait for a log, and save it as a user does."""
    until(tab, "Boolean(document.querySelector('.lab-save'))")
    click(tab, "#tab-lab")
    with tab.expect_download(timeout=PATIENCE_S * 1e3) as download:
        click(tab, ".lab-save")
    download.value.save_as(log)


def drop(tab: Page, name: str, content: bytes) -> None:
    tab.set_input_files(
        "#lab-file", {"name": name, "mimeType": "application/octet-stream", "buffer": content}
    )


@pytest.fixture(scope="module")
def saved(chromium: Browser, page: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log that the page has saved, flown by its address."""
    log = tmp_path_factory.mktemp("saved") / "page.mcap"
    with opened(chromium, page, "plan=hover&speed=20&effect=rotor_lag,s:0.12&seed=5") as tab:
        expect(tab.locator("#kind")).to_have_text("SIMULATION")
        save_log(tab, log)
    return log


def test_page_is_small_and_asks_for_no_port(page: Path) -> None:
    assert page.stat().st_size < MAX_BYTES
    text = page.read_text(encoding="utf-8")
    assert "connect-src" not in text and "default-src 'none'" in text
    assert not re.search(r"navigator\.(serial|usb|bluetooth|hid)", text)


def test_an_address_flies_its_plan_and_heli_host_reads_the_saved_log(saved: Path) -> None:
    log = read_log(saved)
    assert log.metadata["result"]["outcome"] == "completed"
    assert (log.ticks_lost, list(log.notes)) == (0, [])
    assert list(log.metadata["plan"]) == ["hover"]


def test_page_replays_its_own_log_and_one_of_heli_host(
    chromium: Browser, page: Path, saved: Path, tmp_path: Path
) -> None:
    import heli_host

    with heli_host.connect("sil://?board=native") as heli:
        heli.fly("hover", log=tmp_path / "host.mcap")
    with opened(chromium, page) as tab:
        for log in (saved, tmp_path / "host.mcap"):
            drop(tab, log.name, log.read_bytes())
            expect(tab.locator("#kind")).to_have_text("REPLAY")
            until(tab, f"heliPage.hello.board.startsWith({json.dumps(log.name)})")
            rows = len(read_log(log).ticks)
            tab.evaluate("heliLab.tellWorker({text: JSON.stringify({do: 'seek', id: 'seek', t_s: 1e6})})")
            until(tab, f"heliPage.history.end >= {rows} || heliPage.status.at_s >= {rows - 1} / 1000")
        click(tab, "#tab-lab")
        click(tab, "#lab-again")
        expect(tab.locator("#kind")).to_have_text("SIMULATION")


@pytest.mark.parametrize("board_name", ["native", "due"])
def test_a_key_stops_the_motors(chromium: Browser, page: Path, board_name: str) -> None:
    with opened(chromium, page, f"board={board_name}") as tab:
        expect(tab.locator("#board")).to_contain_text("Due" if board_name == "due" else "native")
        click(tab, "#take-off")
        until(tab, "heliPage.history.latest(6) > 0.5")
        tab.keyboard.press("Space")
        until(tab, "heliPage.history.latest(6) === 0 && heliPage.history.latest(7) === 0")
        expect(tab.locator("#stopped")).to_contain_text("STOPPED")


def test_faults_of_the_rig_reach_the_board(chromium: Browser, page: Path) -> None:
    with opened(chromium, page, "speed=5") as tab:
        click(tab, "#take-off")
        until(tab, "heliPage.status.state === 2 && heliPage.history.latest(0) > -0.1")
        click(tab, "#tab-lab")
        click(tab, "[data-fault='motor supply off']")
        until(tab, "['fault', 'emergency landing'].includes(document.querySelector('#state').textContent)")


def test_a_slider_changes_the_effect_in_flight_and_the_address_holds_it(
    chromium: Browser, page: Path
) -> None:
    with opened(chromium, page, "effect=input_delay,s:0.01") as tab:
        click(tab, "#tab-lab")
        slider = tab.locator("#lab-value-s")
        slider.evaluate("element => { element.value = 0.05; element.dispatchEvent(new Event('input')); }")
        until(tab, "location.hash.includes('input_delay,s:0.05')")
        until(tab, "document.querySelector('#event-list').textContent.includes('input_delay.s: 0.05')")


def test_a_hidden_page_pauses_and_says_so(chromium: Browser, page: Path) -> None:
    with opened(chromium, page) as tab:
        tab.evaluate(HIDE, True)
        expect(tab.locator("#lab-paused")).to_contain_text("paused while this page was hidden")
        until(tab, "heliPage.history.latestTick > 0")
        tab.wait_for_timeout(200)
        before = tab.evaluate("heliPage.history.latestTick")
        tab.wait_for_timeout(400)
        assert tab.evaluate("heliPage.history.latestTick") == before
        tab.evaluate(HIDE, False)
        until(tab, f"heliPage.history.latestTick > {before} + 200")


def test_axe_finds_nothing_wrong(chromium: Browser, page: Path) -> None:
    for size in (PHONE, WIDE):
        with opened(chromium, page, "effect=ground_effect", size) as tab:
            for name in TABS:
                click(tab, f"#tab-{name}")
                audit = Axe().run(tab)
                assert not audit.response["violations"], audit.generate_report()


def test_a_hostile_address_gives_one_sentence_and_the_usual_rig(chromium: Browser, page: Path) -> None:
    for address in HOSTILE_ADDRESSES:
        with opened(chromium, page, address) as tab:
            words = tab.locator("#lab-message").text_content() or ""
            assert words.endswith("The usual settings are used."), address
            assert len(words) < 250
            assert tab.evaluate("heliPage.hello.rig_name") == "makki2024"


def hostile_files(log: bytes) -> dict[str, bytes]:
    """Files that are no log, or a damaged one."""
    half, late = len(log) // 2, len(log) - 400
    flipped = bytearray(log)
    flipped[half] ^= 0xFF
    return {
        "empty.mcap": b"",
        "text.mcap": b"elevation,pitch\n1,2\n" * 50,
        "magic only.mcap": log[:8],
        "head only.mcap": log[:300],
        "flipped.mcap": bytes(flipped),
        "zeros.mcap": bytes(10_000),
        "long record.mcap": log[:8] + b"\x06" + (2**62).to_bytes(8, "little") + log[8:200],
        "wrong order.mcap": log[:8] + log[half:late] + log[8:half],
        "<b>name</b>.mcap": b"\x00",
        "repeated.mcap": log[:8] * 100,
    }


def test_a_hostile_file_gives_one_sentence_and_the_flight_goes_on(
    chromium: Browser, page: Path, saved: Path
) -> None:
    with opened(chromium, page) as tab:
        for name, content in hostile_files(saved.read_bytes()).items():
            tab.evaluate("document.querySelector('#lab-message').textContent = ''")
            drop(tab, name, content)
            expect(tab.locator("#lab-message")).not_to_be_empty()
            words = tab.locator("#lab-message").text_content() or ""
            assert len(words) < 250 and name.split(".")[0] in words
            assert tab.evaluate("heliPage.hello.kind") == "simulation"


def test_a_puzzle_hides_its_effect_and_seals_its_logs(chromium: Browser, board: Path, tmp_path: Path) -> None:
    puzzle, log = tmp_path / "puzzle.html", tmp_path / "puzzle.mcap"
    write_page(puzzle, [], None, ["cable_spring.travel=0.06"], puzzle=True)
    assert "cable_spring" not in puzzle.read_text(encoding="utf-8")
    with opened(chromium, puzzle, "plan=hover&speed=20") as tab:
        assert "cable_spring" not in json.dumps(
            tab.evaluate("[heliPage.hello, heliLab.facts, document.body.innerText]")
        )
        save_log(tab, log)
    truth = Truth.read(truth_path(puzzle))
    assert truth.flown["effects"] == ["cable_spring.travel=0.06"]
    truth.check(log, read_log(log).metadata["session"][SEALED])
