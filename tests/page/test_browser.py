"""The page in Chromium: flown, stopped by each way, handed over, lost; nothing asked of any other machine."""

import contextlib
import json
import re
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import heli_host
import numpy as np
import pytest
from heli_host.data.log.reader import read_log
from heli_host.declaration import Axes, Channel, State
from heli_host.errors import CommandRefused, HeliError
from heli_host.fly.plan import Plan
from heli_host.ui.page import service
from heli_host.ui.page.clients import ControlLease
from heli_host.ui.page.cockpit import Cockpit
from heli_host.ui.page.replay import Replay
from heli_host.ui.page.serve import serving
from heli_host.ui.page.source import UNKNOWN

from tests.page import browser as browsers

pytest.importorskip("axe_playwright_python", reason="axe-playwright-python is not installed: make setup")

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from tests.page.browser import (
    PATIENCE_S,
    PHONE,
    PROJECTOR,
    TABLET,
    WIDE,
    Tabs,
    click,
    latest,
    save_log,
    tabs,
    until,
)
from tests.page.page_server import (
    SHORT_PLAN,
    Served,
    SocketPage,
    page_of_a_simulated_board,
    patient_page,
    steady,
    tired,
)
from tests.running.long import LONG, samples
from tests.running.order import REAL_TIME
from tests.web.pages import write_whole_page

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group(REAL_TIME)]

ELEVATION_SETPOINT_DEG = f"{latest(Channel.ELEVATION_SETPOINT)} * 57.3"
TRAVEL_SETPOINT_DEG = f"{latest(Channel.TRAVEL_SETPOINT)} * 57.3"
GAMEPAD = """
window.pad = {connected: true, axes: [0, 0, 0, 0], buttons: [0, 1, 2, 3].map(() => ({pressed: false}))};
navigator.getGamepads = () => [window.pad];
"""
TABS = ("fly", "parameters", "events", "link")


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browsers.chromium() as started:
        yield started


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    with patient_page(tmp_path) as page_server:
        yield page_server


@dataclass(frozen=True)
class BehindServer:
    """The page of a server, with the board behind it."""

    served: Served
    tabs = TABS

    @property
    def address(self) -> str:
        return self.served.address.page

    def run_motors(self, page: Page) -> None:
        run_motors(self.served)
        until_state(page, "open loop")

    def stops(self, page: Page) -> int:
        return self.served.heli.session.stops

    def parameter(self, page: Page, name: str) -> float:
        return self.served.heli.params[name]

    def log(self, page: Page) -> Path:
        return self.served.logs()[0]


@dataclass(frozen=True)
class InFile:
    """The page as one file, with the board in it."""

    page: Path
    folder: Path
    tabs = (*TABS, "lab")

    @property
    def address(self) -> str:
        return f"{self.page.as_uri()}#speed=4&effect=ground_effect"

    def run_motors(self, page: Page) -> None:
        """Take off; the answer is not waited for."""
        take_off = json.dumps({"do": "take_off", "id": "test"})
        end_s = time.monotonic() + PATIENCE_S
        while page.evaluate("document.querySelector('#state').textContent") != "closed loop":
            assert time.monotonic() < end_s, "it does not take off"
            page.evaluate("text => heliLab.tellWorker({text})", take_off)
            page.wait_for_timeout(200)

    def stops(self, page: Page) -> int:
        events = page.locator("#event-list li").all_text_contents()
        return sum("because of stop" in event for event in events)

    def parameter(self, page: Page, name: str) -> float:
        return float(page.input_value(f"#p-{name}"))

    def log(self, page: Page) -> Path:
        save_log(page, self.folder / "saved.mcap")
        return self.folder / "saved.mcap"


Behind = BehindServer | InFile


@pytest.fixture(params=["server", "file"])
def behind(request: pytest.FixtureRequest, tmp_path: Path) -> Behind:
    """The page in both of its forms."""
    if request.param == "server":
        return BehindServer(request.getfixturevalue("served"))
    return InFile(request.getfixturevalue("single_page"), tmp_path)


@pytest.fixture
def window(chromium: Browser) -> Iterator[Tabs]:
    with tabs(chromium) as opened:
        yield opened
        assert not opened.wrong, "\n".join(opened.wrong)


def until_state(page: Page, *names: str) -> None:
    expect(page.locator("#state")).to_have_text(re.compile("|".join(names)), timeout=60_000)


def run_motors(served: Served) -> None:
    """Both motors at a voltage within the dead zone: as quick to begin as to end."""
    heli, end_s = served.heli, time.monotonic() + PATIENCE_S
    while heli.state is not State.ARMED:
        assert time.monotonic() < end_s, f"it does not arm: {heli.events[-3:]}"
        heli.session.release_stop(heli.session.stops)
        # With its drivers on, the arm of this rig floats up from its table, and stays there.
        with contextlib.suppress(CommandRefused):
            heli.zero()
            heli.arm()
        time.sleep(0.05)
    heli.control(Axes(0), front_V=0.8, back_V=0.8)


# Element with the focus, and the key that is pressed then.
WAYS = {
    "space": ("body", "Space"),
    "escape": ("body", "Escape"),
    "enter on the button": ("#stop", "Enter"),
    "space on another button": ("#land", "Space"),
    "space on a slider": ("#set-travel", "Space"),
    "space among words": ("#mark-text", "Space"),
    "escape among words": ("#mark-text", "Escape"),
    "space on a tab": ("#tab-events", "Space"),
    "space in a number": ("#p-travel_kp", "Space"),
    "a click": ("#stop", "click"),
    "a finger": ("#stop", "touch"),
    "a gamepad": ("body", "pad"),
}


def press(page: Page, focus: str, key: str) -> None:
    if focus.startswith("#p-"):
        click(page, "#tab-parameters")
    page.focus(focus)
    if key == "click":
        page.click(focus)
    elif key == "touch":
        page.dispatch_event(focus, "pointerdown", {"pointerType": "touch"})
    elif key == "pad":
        page.evaluate("pad.buttons[1].pressed = true")
        until(page, "['idle'].includes(document.querySelector('#state').textContent)")
        page.evaluate("pad.buttons[1].pressed = false")
    else:
        page.keyboard.press(key)


def test_every_way_to_stop_stops(behind: Behind, window: Tabs) -> None:
    window.context.add_init_script(GAMEPAD)
    page = window.open(behind.address)
    for number, (name, (focus, key)) in enumerate(WAYS.items(), 1):
        click(page, "#tab-fly")
        behind.run_motors(page)
        press(page, focus, key)
        # On a machine that stalls voltages go stale before the press: the state alone proves nothing.
        end_s = time.monotonic() + PATIENCE_S
        while behind.stops(page) < number:
            assert time.monotonic() < end_s, name
            page.wait_for_timeout(10)
        assert behind.stops(page) == number, name
        until_state(page, "idle")
    assert page.input_value("#mark-text") == ""


def until_stopped(served: Served, page: Page) -> None:
    """Press Space in the field for a mark while a motor runs, until the board has heard one stop."""
    page.focus("#mark-text")
    page.keyboard.press("Space")
    end_s = time.monotonic() + PATIENCE_S
    while served.heli.session.stops < 1:
        assert time.monotonic() < end_s, "no stop came"
        time.sleep(0.01)
    assert page.input_value("#mark-text") == "two words"


def test_a_program_that_sends_nan_leaves_every_page_its_status_and_its_stop(
    served: Served, window: Tabs
) -> None:
    page = window.open(served.address.page)
    page.fill("#mark-text", "two")
    page.focus("#mark-text")
    page.keyboard.type(" words")
    assert served.heli.session.stops == 0
    with heli_host.join(served.address.program) as program:
        for value in (float("nan"), float("inf")):
            with pytest.raises(HeliError):
                program.signal("my error", value)
        # The largest numbers that are finite have no place on an axis, and must not end the drawing either.
        for value in (1e308, -1e308, 9e11, -9e11):
            program.signal("my error", value)
        expect(page.locator("#strips")).to_contain_text("my error")
    run_motors(served)
    until_state(page, "open loop")
    expect(page.locator("#alarm")).to_be_hidden()
    until_stopped(served, page)
    until_state(page, "idle")


def test_a_page_without_a_status_alarms_shows_the_frames_state_and_stops(
    served: Served, window: Tabs, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(cockpit: Cockpit) -> dict[str, object]:
        raise KeyError("a defect")

    status = Cockpit.status
    page = window.open(served.address.page)
    page.fill("#mark-text", "two words")
    expect(page.locator("#alarm")).to_be_hidden()
    monkeypatch.setattr(Cockpit, "status", fails)
    expect(page.locator("#alarm")).to_contain_text("no longer sends its status")
    run_motors(served)
    until_state(page, "open loop")
    expect(page.locator("#land")).to_be_enabled()
    until_stopped(served, page)
    until_state(page, "idle")
    monkeypatch.setattr(Cockpit, "status", status)
    expect(page.locator("#alarm")).to_be_hidden()


def test_a_status_that_waited_while_the_page_was_suspended_is_not_shown(
    served: Served, window: Tabs, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = window.open(served.address.page)
    expect(page.locator("#state")).to_have_text("idle")
    stamped = service._with_time

    def old(status: Mapping[str, Any]) -> dict[str, Any]:
        return {**status, "state": int(State.CLOSED_LOOP), "sent_s": time.monotonic() - 5.0}

    monkeypatch.setattr(service, "_with_time", old)
    expect(page.locator("#alarm")).to_contain_text("no longer sends its status")
    expect(page.locator("#state")).to_have_text("idle")
    monkeypatch.setattr(service, "_with_time", stamped)
    expect(page.locator("#alarm")).to_be_hidden()


def test_a_space_is_a_stop_while_no_sample_comes(
    served: Served, window: Tabs, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = window.open(served.address.page)
    page.fill("#mark-text", "two words")
    monkeypatch.setattr(Cockpit, "state", lambda _: UNKNOWN)
    until(page, f"heliPage.frameState === {UNKNOWN[0]}")
    expect(page.locator("#state")).to_have_text("idle")
    until_stopped(served, page)


def test_who_watches_stops_from_every_tab_of_the_panel(served: Served, window: Tabs) -> None:
    window.open(served.address.page)
    second = window.open(served.address.page)
    for name in TABS:
        click(second, f"#tab-{name}")
        run_motors(served)
        until_state(second, "open loop")
        second.keyboard.press("Space")
        until_state(second, "idle")
        expect(second.locator("#stopped")).to_have_text(
            "STOPPED. The board confirms that both motors are off."
        )
        expect(second.locator("#stopped")).to_be_visible()


def test_a_plan_is_flown_from_the_page_and_the_page_holds_what_the_log_holds(
    behind: Behind, window: Tabs
) -> None:
    page = window.open(behind.address)
    click(page, "text=Fly short")
    until_state(page, "closed loop")
    page.keyboard.press("m")
    expect(page.locator("#message")).to_have_text("plan: completed", timeout=90_000)
    expect(page.locator("#recording")).to_contain_text("recorded")
    log = read_log(behind.log(page))
    assert "mark 1" in [event["message"] for event in log.events]
    first, last = (int(log.ticks["tick"][place]) for place in (0, -1))
    until(page, f"heliPage.history.latestTick >= {last}")
    held = page.evaluate(
        """([first, last]) => {
          const h = heliPage.history, from = h.find(first), to = h.find(last) + 1;
          const plain = (all) => Array.from(all.slice(from, to));
          return [h.gaps, h.thinned, plain(h.tick), h.raw.map(plain)];
        }""",
        [first, last],
    )
    gaps, thinned, tick, raw = held
    logged = log.ticks["tick"].tolist()
    assert gaps == 0
    # A computer too busy to show every tick says so, and each that it shows is still the log's.
    assert tick == logged or (thinned > 0 and set(tick) < set(logged))
    np.testing.assert_array_equal(np.array(raw).T, log.raw[np.searchsorted(logged, tick)])


def test_by_hand_with_button_slider_keys_and_gamepad(behind: Behind, window: Tabs) -> None:
    window.context.add_init_script(GAMEPAD)
    page = window.open(behind.address)
    click(page, "#take-off")
    expect(page.locator("#hold")).to_be_enabled()
    until(page, "document.querySelector('#progress').textContent === ''")
    page.fill("#set-travel", "6")
    until(page, f"Math.abs({TRAVEL_SETPOINT_DEG} - 6) < 0.2")
    page.focus("#hold")
    page.keyboard.press("Shift+ArrowRight")
    until(page, f"Math.abs({TRAVEL_SETPOINT_DEG} - 11) < 0.2")
    page.keyboard.press("ArrowDown")
    until(page, f"Math.abs({ELEVATION_SETPOINT_DEG} + 1) < 0.2")
    page.evaluate("pad.axes[1] = -1")
    until(page, f"{ELEVATION_SETPOINT_DEG} > 1")
    page.evaluate("pad.axes[1] = 0")
    click(page, "#land")
    until_state(page, "landing")
    until_state(page, "idle")
    assert behind.stops(page) == 0


def test_a_parameter_is_changed_in_flight_and_taken_back(behind: Behind, window: Tabs) -> None:
    page = window.open(behind.address)
    behind.run_motors(page)
    click(page, "#tab-parameters")
    page.fill("#filter", "travel_k")
    page.fill("#p-travel_kp", "0.7")
    page.keyboard.press("Enter")
    expect(page.locator("#parameter-message")).to_contain_text("travel_kp is 0.7")
    assert behind.parameter(page, "travel_kp") == 0.7
    page.fill("#p-travel_kp", "-3")
    page.keyboard.press("Enter")
    expect(page.locator("#parameter-message")).to_contain_text("out of range")
    expect(page.locator("#p-travel_kp")).to_have_value("0.7")
    page.fill("#filter", "supply")
    expect(page.locator("#p-supply_V")).to_be_disabled()
    expect(page.locator("#parameter-list")).to_contain_text("only while idle")
    expect(page.locator("#save")).to_be_disabled()
    click(page, "#undo")
    expect(page.locator("#undo")).to_be_disabled()
    assert behind.parameter(page, "travel_kp") == pytest.approx(0.6)
    page.keyboard.press("Escape")
    until_state(page, "idle")
    expect(page.locator("#p-supply_V")).to_be_enabled()
    click(page, "#save")
    expect(page.locator("#message")).to_contain_text("saved in the board's flash")


def test_two_tabs_one_flies_and_hands_over_when_asked(served: Served, window: Tabs) -> None:
    first, second = window.open(served.address.page), window.open(served.address.page)
    expect(second.locator("#control")).to_contain_text("You watch; page 1 flies")
    expect(second.locator("#take-off")).to_be_disabled()
    expect(second.locator("#why-fly")).to_have_text(
        "Take off, Land, Hold here: only the pilot may do this; ask for control."
    )
    expect(first.locator("#why-setpoint")).to_have_text("Sliders: only in flight; take off first.")
    click(second, "text=Ask for control")
    click(first, "text=Hand over")
    expect(second.locator("#control")).to_contain_text("You fly")
    expect(first.locator("#control")).to_contain_text("You watch")
    expect(second.locator("#take-off")).to_be_enabled()


@pytest.mark.parametrize("fate", ["closed", "crashed", "suspended"][: samples(3, 1)])
def test_the_pilot_s_tab_is_lost_and_the_board_lands(served: Served, chromium: Browser, fate: str) -> None:
    with tabs(chromium) as first, tabs(chromium) as other:
        pilot, watcher = first.open(served.address.page), other.open(served.address.page)
        click(pilot, "#take-off")
        until_state(watcher, "closed loop")
        if fate == "closed":
            pilot.close()
        elif fate == "crashed":
            with pytest.raises(Exception, match="crash"):
                pilot.goto("chrome://crash")
        else:
            pilot.evaluate("setTimeout(() => { const t = Date.now(); while (Date.now() - t < 15000); })")
        until_state(watcher, "hold")
        until_state(watcher, "landing")
        cause = "does not answer" if fate == "suspended" else "was closed"
        expect(watcher.locator("#event-list")).to_contain_text(f"state landing: the pilot's page {cause}")
        until_state(watcher, "idle")
        assert served.heli.session.stops == 0


def test_a_page_that_hangs_is_there_for_a_moment_and_then_no_more(
    served: Served, window: Tabs, monkeypatch: pytest.MonkeyPatch
) -> None:
    signs_s: list[float] = []

    def noted(lease: ControlLease, client: str, now_s: float) -> None:
        signs_s.append(time.time())
        beat(lease, client, now_s)

    beat = ControlLease.beat
    monkeypatch.setattr(ControlLease, "beat", noted)
    page = window.open(served.address.page)
    until(page, "heliPage.history.end > 500")
    from_ms, to_ms = page.evaluate(
        "() => { const from = Date.now(); while (Date.now() - from < 5500); return [from, Date.now()]; }"
    )
    from_s, to_s = from_ms / 1e3, to_ms / 1e3
    early, late = (from_s + 0.3, from_s + 3.0), (from_s + 4.6, to_s)
    # Ten a second; a machine that stalls for a second has sent some of them.
    assert sum(early[0] < sign_s < early[1] for sign_s in signs_s) >= 3
    assert not any(late[0] < sign_s < late[1] for sign_s in signs_s)


@contextlib.contextmanager
def page_with_laws(kind: str, folder: Path) -> Iterator[str]:
    """Offer two laws on a page; yields its address."""
    laws = [steady().program, tired().program]
    if kind == "server":
        with patient_page(folder, laws) as served:
            yield served.address.page
    else:
        yield write_whole_page(folder, laws).as_uri()


@pytest.mark.parametrize("kind", ["server", "file"])
def test_a_law_is_chosen_its_signal_drawn_and_why_it_was_taken_over_said(
    kind: str, tmp_path: Path, chromium: Browser
) -> None:
    with page_with_laws(kind, tmp_path) as address, tabs(chromium) as opened:
        page = opened.open(address)
        click(page, "#laws >> text=steady")
        expect(page.locator("#law-message")).to_have_text("steady is loaded, and flies after take-off")
        click(page, "#laws >> text=tired")
        expect(page.locator("#law-message")).to_have_text("tired is loaded, and flies after take-off")
        page.fill("#law-kp", "17")
        page.keyboard.press("Enter")
        click(page, "#take-off")
        expect(page.locator("#law-message")).to_contain_text(
            "the board's own control law took over: voltage jump"
        )
        expect(page.locator("#strips")).to_contain_text("wanted_pitch")
        axe = Axe().run(page).response["violations"]
        assert not [issue["id"] for issue in axe if issue["impact"] in ("serious", "critical")]
        click(page, "#laws >> text=steady")
        expect(page.locator("#message")).to_contain_text("land first")
        click(page, "#laws >> text=board's own")
        expect(page.locator("#law-message")).to_have_text("the board's own control law")
        page.keyboard.press("Space")
        until_state(page, "idle")
        assert not opened.wrong


def test_a_tab_that_is_reloaded_keeps_control(served: Served, window: Tabs) -> None:
    page = window.open(served.address.page)
    window.open(served.address.page)
    page.reload()
    expect(page.locator("#control")).to_contain_text("You fly")


def test_a_duplicated_tab_connects_again_with_the_id_that_the_server_gave_it(
    served: Served, window: Tabs
) -> None:
    with SocketPage(served.address, "original"):
        page = window.open(served.address.page)
        page.evaluate("sessionStorage.setItem('client', 'original')")
        page.reload()
        until(page, "sessionStorage.getItem('client') != 'original'")


def test_a_twin_s_alarm_is_a_red_bar(served: Served, window: Tabs, monkeypatch: pytest.MonkeyPatch) -> None:
    alarm = {"words": "Twin: alarm at 3.0 s.", "alarm": True, "ghost_rad": [0.1, 0.0, 0.0]}
    page = window.open(served.address.page)
    expect(page.locator("#twin-alarm")).to_be_hidden()
    monkeypatch.setattr(Cockpit, "_twin_status", lambda _: alarm)
    expect(page.locator("#twin-alarm")).to_have_text("TWIN ALARM: the rig has changed. Alarm at 3.0 s.")
    expect(page.locator("#ghost-twin")).to_be_visible()
    expect(page.locator("#ghost-setpoint")).to_be_hidden()


def test_a_replay_does_not_look_like_a_flight(tmp_path: Path, chromium: Browser) -> None:
    log = tmp_path / "flight.mcap"
    with heli_host.connect("sil://?speed=max") as heli:
        heli.fly(Plan.parse(SHORT_PLAN, "short"), log=log)
    replay = Replay(read_log(log), {})
    replay.actions["seek"].run({"t_s": 5.0})
    with serving(replay) as address, tabs(chromium) as opened:
        page = opened.open(address.page)
        expect(page.locator("#kind")).to_have_text("REPLAY")
        expect(page.locator("#state")).to_have_text("closed loop")
        expect(page.locator("#words")).to_contain_text("The log shows")
        assert not re.search("It flies|You fly|STOP", page.locator("body").inner_text())
        assert not opened.wrong


def test_a_server_that_is_gone_is_said_large(tmp_path: Path, chromium: Browser) -> None:
    with tabs(chromium) as opened:
        with page_of_a_simulated_board(tmp_path) as served:
            page = opened.open(served.address.page)
        expect(page.locator("#alarm")).to_contain_text("The server does not answer")
        page.keyboard.press("Space")
        expect(page.locator("#message")).to_contain_text("use the rig's own stop switch")


def test_strips_pause_zoom_and_go_on(behind: Behind, window: Tabs) -> None:
    page = window.open(behind.address)
    until(page, "heliPage.history.end > 2000")
    legend = page.locator("#strips .u-legend").first
    expect(legend).to_contain_text(re.compile(r"elevation-?\d+\.\d\d"))
    ticks = page.evaluate("heliPage.strips.plots.map(({ u }) => u.axes[1]._splits.length)")
    assert min(ticks) >= 2
    labels = page.evaluate("heliPage.strips.plots.map(({ u }) => u.axes[0]._values.join(''))")
    assert [bool(text) for text in labels] == [False] * (len(labels) - 1) + [True]
    box = page.locator("#strips .u-over").first.bounding_box()
    assert box is not None
    x, y = box["x"], box["y"] + box["height"] / 2
    page.mouse.move(x + box["width"] * 0.9, y)
    expect(page.locator("#strips .u-legend").first).to_contain_text(re.compile(r"\d\.\d{3} s"))
    page.mouse.down()
    page.mouse.move(x + box["width"] * 0.98, y, steps=4)
    page.mouse.up()
    expect(page.locator("#pause")).to_have_text("Continue")
    from_s, to_s = page.evaluate("heliPage.strips.range()")
    assert to_s - from_s == pytest.approx(0.08 * 20, rel=0.1)
    page.wait_for_timeout(300)
    assert page.evaluate("heliPage.strips.range()") == [from_s, to_s]
    page.mouse.wheel(0, 300)
    until(page, f"heliPage.strips.range()[1] - heliPage.strips.range()[0] > {to_s - from_s}")
    click(page, "#pause")
    click(page, "text=5 min")
    low, high = page.evaluate("heliPage.strips.range()")
    assert high - low == pytest.approx(300.0)


@pytest.mark.parametrize("size", [WIDE, TABLET, PROJECTOR], ids=["wide", "tablet", "projector"])
def test_everything_has_its_place_and_axe_finds_nothing(
    behind: Behind, chromium: Browser, size: tuple[int, int], tmp_path: Path
) -> None:
    with tabs(chromium, size) as opened:
        page, axe = opened.open(behind.address), Axe()
        for name in behind.tabs:
            click(page, f"#tab-{name}")
            page.wait_for_timeout(200)
            # Findings of axe depend on text and colours, which are the same at every size.
            if size == WIDE or name == behind.tabs[-1] or LONG:
                violations = axe.run(page).response["violations"]
                assert not violations, [
                    (issue["id"], [node["html"] for node in issue["nodes"]]) for issue in violations
                ]
            box = page.locator("#stop").bounding_box()
            assert box is not None
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= size[0]
            assert box["y"] + box["height"] <= size[1]
            assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
        bottoms = page.evaluate(
            """['#strips .uplot:last-child', '#plots'].map((one) =>
                 document.querySelector(one).getBoundingClientRect().bottom)"""
        )
        assert bottoms[0] <= bottoms[1]
        expect(page.locator("#badge")).to_have_text("SIMULATION makki2024")
        # The whole height is used, and nothing is below it.
        last = page.evaluate(
            """Math.max(...['#rig', '#panel'].map((one) =>
                 document.querySelector(one).getBoundingClientRect().bottom))"""
        )
        assert size[1] - 12 <= last <= size[1]
        page.screenshot(path=tmp_path / "page.png")
        assert not opened.wrong


def test_a_phone_shows_whole_titles_and_one_time_for_all_strips(behind: Behind, chromium: Browser) -> None:
    with tabs(chromium, PHONE) as opened:
        page = opened.open(behind.address)
        titles = page.evaluate(
            """heliPage.strips.plots.map(({ u }) => {
                 const [, axis] = u.axes;
                 u.ctx.font = axis.labelFont[0];
                 return [u.ctx.measureText(axis.label).width, u.over.clientHeight * devicePixelRatio];
               })"""
        )
        assert all(width <= height for width, height in titles), titles
        assert page.locator("#strips .u-legend tr:first-child").evaluate_all(
            "rows => rows.map((row) => row.offsetHeight > 0)"
        ) == [False, False, False, True]
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE[0]
        assert not opened.wrong


def test_the_keyboard_alone_flies(behind: Behind, window: Tabs) -> None:
    page = window.open(behind.address)

    def reach(selector: str) -> None:
        for _ in range(60):
            if page.evaluate(f"document.activeElement.matches({selector!r})"):
                return
            page.keyboard.press("Tab")
        raise AssertionError(f"{selector} is not reached")

    reach("#take-off")
    page.keyboard.press("Enter")
    until_state(page, "closed loop")
    until(page, "document.querySelector('#progress').textContent === ''")
    reach("#set-travel")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    until(page, f"Math.abs({TRAVEL_SETPOINT_DEG} - 1) < 0.1")
    reach("#record")
    page.keyboard.press("Enter")
    expect(page.locator("#record")).to_have_text("Stop recording")
    reach("#mark-text")
    page.keyboard.type("windy")
    page.keyboard.press("Enter")
    reach("#record")
    page.keyboard.press("Enter")
    expect(page.locator("#record")).to_have_text("Record")
    reach("[role=tab][aria-selected=true]")
    page.keyboard.press("ArrowRight")
    reach("#p-travel_kp")
    page.keyboard.press("Space")
    until_state(page, "idle")
    assert "windy" in [event["message"] for event in read_log(behind.log(page)).events]
