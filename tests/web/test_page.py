"""The page in Chromium, from a file and with the network off: flown, stopped, saved, replayed, attacked."""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zstandard as zstd
from heli_host.data.log.blind import SEALED, Truth, truth_path
from heli_host.data.log.reader import read_log
from heli_host.declaration import Channel, State
from heli_web.build import write_page
from playwright.sync_api import Browser, Page, expect

from tests.page import browser as browsers
from tests.page.browser import click, latest, save_log, tabs, until
from tests.running.order import REAL_TIME

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group(REAL_TIME)]

HIDE = """hidden => {
  Object.defineProperty(document, "hidden", {value: hidden, configurable: true});
  document.dispatchEvent(new Event("visibilitychange"));
}"""
WATCH_PITCH = """() => {
  window.largestPitch = 0;
  setInterval(() => { largestPitch = Math.max(largestPitch, heliPage.history.latest(1)); }, 5);
}"""
IS_FLYING = f"heliPage.status.state === {int(State.CLOSED_LOOP)}"
MAX_BYTES = 1_500_000
HOSTILE_ADDRESSES = (
    "a" * 5000, "%00%ff%", "rig=../../etc/passwd", "rig=", "board=real", "board=", "seed=-1", "seed=1e99",
    "seed=NaN", "speed=1e9", "speed=0", "speed=", "plan=<script>", "plan=hover&plan=javascript:alert(1)",
    "effect=nothing", "effect=rotor_lag,s:1e9", "effect=rotor_lag,q:1", "effect=rotor_lag,__proto__:1",
    "effect=x,s:", "effect=,", "set=travel_kp:1e30", "set=travel_kp:", "set=__proto__:1", "nonsense=1", "=1",
    "toString",
)  # fmt: skip


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browsers.chromium() as started:
        yield started


@contextmanager
def opened(browser: Browser, page: Path, address: str = "") -> Iterator[Page]:
    """Open the page in a window without a network. An error in it, or a request, fails the test."""
    with tabs(browser, offline=True) as window:
        yield window.open(f"{page.as_uri()}#{address}")
        assert not window.wrong, "\n".join(window.wrong)


def drop(tab: Page, name: str, content: bytes) -> None:
    tab.set_input_files(
        "#lab-file", {"name": name, "mimeType": "application/octet-stream", "buffer": content}
    )


@pytest.fixture(scope="module")
def saved(chromium: Browser, single_page: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log that the page has saved, flown by its address."""
    log = tmp_path_factory.mktemp("saved") / "page.mcap"
    with opened(chromium, single_page, "plan=hover&speed=20&effect=rotor_lag,s:0.12&seed=5") as tab:
        expect(tab.locator("#kind")).to_have_text("SIMULATION")
        save_log(tab, log)
    return log


def test_page_is_small_and_asks_for_no_port(single_page: Path) -> None:
    assert single_page.stat().st_size < MAX_BYTES
    text = single_page.read_text(encoding="utf-8")
    assert "connect-src" not in text and "default-src 'none'" in text
    assert not re.search(r"navigator\.(serial|usb|bluetooth|hid)", text)


def test_an_address_flies_its_plan_and_heli_host_reads_the_saved_log(saved: Path) -> None:
    log = read_log(saved)
    assert log.metadata["result"]["outcome"] == "completed"
    assert (log.ticks_lost, list(log.notes)) == (0, [])
    assert list(log.metadata["plan"]) == ["hover"]


def test_page_replays_its_own_log_and_one_of_heli_host(
    chromium: Browser, single_page: Path, saved: Path, tmp_path: Path
) -> None:
    import heli_host

    with heli_host.connect("sil://?board=native") as heli:
        heli.fly("hover", log=tmp_path / "host.mcap")
    with opened(chromium, single_page) as tab:
        for log in (saved, tmp_path / "host.mcap"):
            drop(tab, log.name, log.read_bytes())
            expect(tab.locator("#kind")).to_have_text("REPLAY")
            until(tab, f"heliPage.hello.board.startsWith({json.dumps(log.name)})")
            rows = len(read_log(log).ticks)
            expect(tab.locator("#words")).to_contain_text("The log shows")
            assert not re.search("It flies|You fly|STOP", tab.locator("body").inner_text())
            tab.evaluate("heliLab.tellWorker({text: JSON.stringify({do: 'seek', id: 'seek', t_s: 1e6})})")
            until(tab, f"heliPage.history.end >= {rows} || heliPage.status.at_s >= {rows - 1} / 1000")
        click(tab, "#tab-lab")
        click(tab, "#lab-again")
        expect(tab.locator("#kind")).to_have_text("SIMULATION")


def test_a_key_stops_the_motors_of_the_emulated_due(chromium: Browser, single_page: Path) -> None:
    with opened(chromium, single_page, "board=due") as tab:
        expect(tab.locator("#board")).to_contain_text("Due")
        click(tab, "#take-off")
        until(tab, f"{latest(Channel.FRONT)} > 0.5")
        tab.keyboard.press("Space")
        until(tab, f"{latest(Channel.FRONT)} === 0 && {latest(Channel.BACK)} === 0")
        expect(tab.locator("#stopped")).to_contain_text("STOPPED")


def test_faults_of_the_rig_reach_the_board(chromium: Browser, single_page: Path) -> None:
    with opened(chromium, single_page, "speed=5") as tab:
        click(tab, "#take-off")
        until(tab, f"{IS_FLYING} && {latest(Channel.ELEVATION_COUNT)} > -0.1")
        click(tab, "#tab-lab")
        click(tab, "[data-fault='motor supply off']")
        until(tab, "['fault', 'emergency landing'].includes(document.querySelector('#state').textContent)")


def test_a_push_in_the_air_turns_its_axis(chromium: Browser, single_page: Path) -> None:
    with opened(chromium, single_page, "speed=10") as tab:
        click(tab, "#tab-lab")
        until(tab, "heliPage.history.latestTick > 50")
        click(tab, "[data-push='pitch']")
        expect(tab.locator("#lab-message")).to_contain_text("take off first")
        tab.evaluate("heliLab.tellWorker({text: JSON.stringify({do: 'take_off', id: 'test'})})")
        until(tab, f"{IS_FLYING} && {latest(Channel.ELEVATION_COUNT)} > -0.1")
        tab.evaluate(WATCH_PITCH)
        click(tab, "[data-push='pitch']")
        expect(tab.locator("#event-list")).to_contain_text("pitch is pushed")
        until(tab, "largestPitch > 0.05")


def test_a_slider_changes_the_effect_in_flight_and_the_address_holds_it(
    chromium: Browser, single_page: Path
) -> None:
    with opened(chromium, single_page, "effect=input_delay,s:0.01") as tab:
        click(tab, "#tab-lab")
        slider = tab.locator("#lab-value-s")
        slider.evaluate("element => { element.value = 0.05; element.dispatchEvent(new Event('input')); }")
        until(tab, "location.hash.includes('input_delay,s:0.05')")
        until(tab, "document.querySelector('#event-list').textContent.includes('input_delay.s: 0.05')")


def test_a_hidden_page_pauses_and_says_so(chromium: Browser, single_page: Path) -> None:
    with opened(chromium, single_page) as tab:
        tab.evaluate(HIDE, True)
        expect(tab.locator("#lab-paused")).to_contain_text("paused while this page was hidden")
        until(tab, "heliPage.history.latestTick > 0")
        tab.wait_for_timeout(200)
        before = tab.evaluate("heliPage.history.latestTick")
        tab.wait_for_timeout(400)
        assert tab.evaluate("heliPage.history.latestTick") == before
        tab.evaluate(HIDE, False)
        until(tab, f"heliPage.history.latestTick > {before} + 200")


def test_a_hostile_address_gives_one_sentence_and_the_usual_rig(chromium: Browser, single_page: Path) -> None:
    with opened(chromium, single_page, HOSTILE_ADDRESSES[0]) as tab:
        for address in HOSTILE_ADDRESSES:
            tab.evaluate(
                "address => { if (location.hash !== `#${address}`) location.hash = address; }", address
            )
            expect(tab.locator("#lab-message")).not_to_be_empty()
            words = tab.locator("#lab-message").text_content() or ""
            assert words.endswith("The usual settings are used."), address
            assert len(words) < 250
            assert "  " not in words
            tab.evaluate("document.querySelector('#lab-message').textContent = ''")
            until(tab, "heliPage.status.connected && heliPage.hello.rig_name === 'makki2024'")


def chunk(content: bytes, size: int | None = None, compression: bytes = b"") -> bytes:
    """A record of MCAP that holds other records; its checksum is left out."""
    head = bytes(16) + (len(content) if size is None else size).to_bytes(8, "little") + bytes(4)
    text = len(compression).to_bytes(4, "little") + compression
    return record(6, head + text + len(content).to_bytes(8, "little") + content)


def record(op: int, content: bytes) -> bytes:
    return bytes([op]) + len(content).to_bytes(8, "little") + content


def hostile_files(log: bytes) -> dict[str, bytes]:
    """Files that are no log, or a damaged one."""
    half, late = len(log) // 2, len(log) - 400
    magic, flipped = log[:8], bytearray(log)
    flipped[half] ^= 0xFF
    zeros, large = (zstd.compress(content) for content in (bytes(1 << 20), record(99, bytes((1 << 24) - 9))))
    return {
        "empty.mcap": b"",
        "text.mcap": b"elevation,pitch\n1,2\n" * 50,
        "picture.png": b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 8,
        "archive.zip": b"PK\x03\x04" + bytes(200),
        "magic only.mcap": magic,
        "head only.mcap": log[:300],
        "flipped.mcap": bytes(flipped),
        "zeros.mcap": bytes(10_000),
        "long record.mcap": magic + b"\x06" + (2**62).to_bytes(8, "little") + log[8:200],
        "wrong order.mcap": magic + log[half:late] + log[8:half],
        "<b>name</b>.mcap": b"\x00",
        "a" * 300 + ".mcap": b"\x00",
        "\u202edrawkcab.mcap": b"\x00",
        "repeated.mcap": magic * 100,
        "large chunk.mcap": magic + chunk(b"", size=2**40),
        "wrong size.mcap": magic + chunk(zeros, size=10, compression=b"zstd"),
        "no zstd.mcap": magic + chunk(bytes(100), size=100, compression=b"zstd"),
        "lz4.mcap": magic + chunk(bytes(100), compression=b"lz4"),
        "expanding.mcap": magic + chunk(large, size=1 << 24, compression=b"zstd") * 17,
        "chunks in chunks.mcap": magic + chunk(chunk(chunk(b""))),
        "no messages.mcap": magic + record(99, b"") * 100_000,
        "bad text.mcap": magic + record(3, b"\x01\x00\xff\xff\xff\xff"),
        "other schema.mcap": log.replace(b"float32 elevation_rad", b"float64 elevation_rad", 1),
        "other channel.mcap": log.replace(b" elevation_count", b" elevation_coumt", 1),
    }


def test_a_hostile_file_gives_one_sentence_and_the_flight_goes_on(
    chromium: Browser, single_page: Path, saved: Path
) -> None:
    with opened(chromium, single_page) as tab:
        click(tab, "#take-off")
        until(tab, IS_FLYING)
        for name, content in hostile_files(saved.read_bytes()).items():
            tab.evaluate("document.querySelector('#lab-message').textContent = ''")
            drop(tab, name, content)
            expect(tab.locator("#lab-message")).to_contain_text(";")
            words = tab.locator("#lab-message").text_content() or ""
            assert len(words) < 250
            assert name.split(".")[0][:60] in words
            assert tab.evaluate("heliPage.hello.kind") == "simulation", name
            # If the machine stalls for seconds, setpoints stop, which ends the flight: HUNG_MS in worker.js.
            stalled = "setpoints stopped coming" in (tab.locator("#event-list").text_content() or "")
            assert stalled or tab.evaluate("heliPage.status.state") == 2, name


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
