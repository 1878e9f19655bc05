"""The page's server: who is let in, who flies, what is shown and served, and what a stop does."""

import gzip
import re
import signal
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import heli_host
import numpy as np
import pytest
from heli_host.data.log.reader import read_log
from heli_host.declaration import Channel, Flags, State, Trigger
from heli_host.ui.page.client import PageError
from heli_host.ui.page.serve import Address
from heli_host.ui.page.service import page_file
from heli_host.ui.page.telemetry import THINNED
from heli_sim.sil.transport import SilProcess
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tests.page.fetch_vendor import FOLDER, integrity, pinned, stored, unpacked
from tests.page.page_server import Served, SocketPage, page_process, patient_page, steady, tired
from tests.running.order import REAL_TIME

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group(REAL_TIME)]

STATIC = FOLDER.parent
OWN = sorted(path for path in STATIC.glob("*") if path.suffix in (".js", ".html", ".css", ".svg"))

pytest.importorskip("starlette", reason="the extra 'page' is not installed: make setup")


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    with patient_page(tmp_path) as server:
        yield server


def status_of(url: str, method: str = "GET", **headers: str) -> int:
    """Return the HTTP status of the answer to a request."""
    names = {"host": "Host", "origin": "Origin"}
    request = urllib.request.Request(
        url, method=method, headers={names[name]: value for name, value in headers.items()}
    )
    try:
        with urllib.request.urlopen(request, timeout=20) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code


def test_nobody_is_let_in_without_the_token_or_from_elsewhere(served: Served) -> None:
    address = served.address
    base = f"http://127.0.0.1:{address.port}"
    stop = f"{base}/stop?token={address.token}"
    assert status_of(f"{base}/") == 403
    assert status_of(f"{base}/?token=wrong") == 403
    assert status_of(address.page) == 200
    assert status_of(f"{base}/stop", "POST") == 403
    assert status_of(stop, "POST", origin="http://elsewhere.example") == 403
    assert status_of(stop, "POST", host="elsewhere.example") == 421
    assert served.heli.session.stops == 0
    for path in ("/ws", "/stop"):
        for query, headers in (
            ("", {}),
            ("?token=wrong", {}),
            (f"?token={address.token}", {"Origin": "http://elsewhere.example"}),
        ):
            url = f"ws://127.0.0.1:{address.port}{path}{query}"
            with pytest.raises(InvalidStatus), connect(url, additional_headers=headers, proxy=None):
                pass
    assert status_of(stop, "POST", origin=base) == 200
    assert served.heli.session.stops == 1


def test_no_file_beyond_the_page_is_served(served: Served) -> None:
    base = f"http://127.0.0.1:{served.address.port}"
    for path in (
        "../cockpit.py",
        "%2e%2e/cockpit.py",
        "..%2fcockpit.py",
        "cockpit.py",
        "README.md",
        "/etc/passwd",
    ):
        assert status_of(f"{base}/{path}") in (400, 404), path


def test_the_first_page_flies_and_the_second_watches_but_can_stop(served: Served) -> None:
    with SocketPage(served.address) as first, SocketPage(served.address) as second:
        assert first.flies
        assert not second.flies
        for name in ("take_off", "land", "record", "setpoint", "set", "save"):
            refused = second.ask(name, name="hover_V", value=1.0, elevation_deg=0.0, on=True)
            assert refused["error"] == "page 1 is the pilot, and you watch"
        assert not first.ask("take_off").get("error")
        assert first.state == "closed_loop"
        assert second.stop() == "stopped"
        first.until_state("idle")
        assert served.heli.session.stops == 1


def test_control_is_handed_over_by_asking(served: Served) -> None:
    with SocketPage(served.address) as first, SocketPage(served.address) as second:
        assert second.ask("ask")["granted"] is False
        first.until(lambda: first.known["control"]["asking_name"] == "page 2")
        assert "error" in second.ask("grant")
        assert first.ask("keep")["granted"] is False
        assert not second.flies
        second.ask("ask")
        assert first.ask("grant")["granted"] is True
        second.until(lambda: second.flies)
        assert "error" in first.ask("take_off")


def test_a_pilot_who_is_back_while_it_holds_flies_on(served: Served) -> None:
    with SocketPage(served.address, client="tab") as second_look:
        second_look.ask("take_off")
        with SocketPage(served.address) as watcher:
            second_look.close()
            watcher.until_state("hold")
            with SocketPage(served.address, client="tab") as again:
                assert again.flies
                again.until_state("closed_loop")
                again.stop()


def test_a_pilot_whose_page_falls_silent_is_a_missing_setpoint_and_the_board_lands(served: Served) -> None:
    with SocketPage(served.address) as first, SocketPage(served.address) as second:
        number = first.send("fly", plans=["hover"])
        second.until(lambda: (second.known["status"]["flight"] or {}).get("phase") == "hover")
        first.answers.clear()
        second.until_state("hold")
        second.until_state("landing")
        second.until_state("idle")
        assert "state hold: the pilot's page does not answer" in second.events("state")
        assert "state landing: the pilot's page does not answer" in first.answer(number)["outcome"]
        assert served.heli.session.stops == 0


def test_a_duplicated_tab_is_a_client_of_its_own(served: Served) -> None:
    with (
        SocketPage(served.address, client="same") as first,
        SocketPage(served.address, client="same") as second,
    ):
        assert first.flies
        assert not second.flies


def test_what_a_page_shows_is_what_the_log_holds(served: Served) -> None:
    with SocketPage(served.address) as page, SocketPage(served.address), SocketPage(served.address):
        answer = page.ask("fly", plans=["short"])
        assert answer["outcome"] == "completed"
        page.ask("mark", text="after it")
        page.until(lambda: not page.known["status"]["recording"])
        log = read_log(served.logs()[0])
        page.until(
            lambda: int(page.rows[-1].tick[-1] if len(page.rows[-1].tick) else 0) > int(log.ticks["tick"][-1])
        )
        rows = [batch for batch in page.rows if len(batch.tick)]
        tick = np.concatenate([batch.tick for batch in rows])
        raw = np.concatenate([batch.raw for batch in rows])
        logged = log.ticks["tick"].astype(np.int64)
        start = int(np.searchsorted(tick, logged[0]))
        shown = slice(start, start + len(logged))
        np.testing.assert_array_equal(tick[shown], logged)
        np.testing.assert_array_equal(raw[shown], log.raw)
        assert not any(batch.flags & THINNED for batch in rows[1:])
        assert log.metadata["result"]["outcome"] == "completed"
        assert "hold" in log.metadata["plan"]["short"]


def test_a_client_that_does_not_keep_up_gets_fewer_rows_and_holds_nobody_up(served: Served) -> None:
    with SocketPage(served.address) as quick, SocketPage(served.address) as slow:
        slow.answers.clear()
        quick.until(lambda: bool(quick.rows))
        start = quick.rows[-1].number
        begin = len(slow.rows)
        quick.until(lambda: quick.rows[-1].number > start + 100)
        held = len(slow.rows)
        quick.until(lambda: quick.rows[-1].number > start + 200)
        assert len(slow.rows) == held <= begin + 10
        tick = np.concatenate([batch.tick for batch in quick.rows[1:]])
        assert (np.diff(tick) == 1).all()
        slow.answers.set()
        slow.socket.send(slow.rows[-1].number.to_bytes(4, "little"))
        slow.until(lambda: len(slow.rows) > held + 3)
        late = slow.rows[held]
        assert late.flags & THINNED
        assert len(late.tick) <= 5000
        assert int(late.tick[-1] - late.tick[0]) > 5000


def test_parameters_change_in_flight_where_the_declaration_lets_them(served: Served) -> None:
    with SocketPage(served.address) as first, SocketPage(served.address) as second:
        before = first.known["hello"]["values"]["travel_kp"]
        first.ask("take_off")
        assert first.ask("set", name="travel_kp", value=0.7)["value"] == 0.7
        second.until(
            lambda: any(message.get("values", {}).get("travel_kp") == 0.7 for message in list(second.words))
        )
        assert (
            "idle"
            in first.ask("set", name="supply_V", value=11.0)["error"]
            + first.ask("set", name="supply_V", value=11.0)["remedy"]
        )
        assert "error" in first.ask("set", name="travel_kp", value=1e6)
        assert "error" in second.ask("set", name="travel_kp", value=0.8)
        first.ask("share", on=True)
        assert second.ask("set", name="travel_kp", value=0.8)["value"] == 0.8
        assert first.ask("undo") | {"answer": 0} == {
            "answer": 0,
            "do": "undo",
            "name": "travel_kp",
            "value": 0.7,
        }
        assert first.ask("undo")["value"] == before
        assert served.heli.params["travel_kp"] == before
        assert "error" in first.ask("undo")
        first.stop()


def test_the_pilot_chooses_a_law_and_a_plan_is_flown_under_it(tmp_path: Path) -> None:
    laws = [steady().program, tired().program]
    with (
        patient_page(tmp_path, laws) as served,
        SocketPage(served.address) as first,
        SocketPage(served.address) as second,
    ):
        offered = first.known["hello"]["laws"]
        assert [(law["name"], law["signals"]) for law in offered] == [
            ("steady", ["wanted_pitch", "kp"]),
            ("tired", ["wanted_pitch", "kp"]),
        ]
        assert second.ask("law", name="steady")["error"] == "page 1 is the pilot, and you watch"
        assert "unknown control law nosuch" in first.ask("law", name="nosuch")["error"]
        assert first.ask("law", name="steady")["law"] == "steady"
        plan = first.send("fly", plans=["short"])
        second.until(lambda: second.known["status"]["law"]["flies"])
        assert second.known["status"]["law"]["chosen"] == "steady"
        assert first.ask("set_law", name="kp", value=17.0)["value"] == 17.0
        assert "error" in second.ask("set_law", name="kp", value=16.0)
        second.until(lambda: second.known["status"]["law"]["values"] == {"kp": 17.0})
        assert first.answer(plan)["outcome"] == "completed"
        assert "steady kp: 16 -> 17" in [event["message"] for event in read_log(served.logs()[0]).events]
        renamed = [message["channels"] for message in list(second.words) if "channels" in message][-1]
        assert "wanted_pitch" in [channel["signal"] for channel in renamed]
        log = read_log(served.logs()[0])
        assert log.metadata["law"]["signal_1"] == "wanted_pitch"
        flew = log.raw[:, Channel.FLAGS] & Flags.LAW != 0
        assert flew.sum() > 1000


def test_a_stop_during_the_take_off_ends_it_and_a_later_one_flies_again(served: Served) -> None:
    with SocketPage(served.address) as page:
        number = page.send("take_off")
        page.until_state("closed_loop")
        page.stop()
        page.until_state("idle")
        page.answer(number)
        assert served.heli.state is State.IDLE
        # The arm falls from where the stop came; the board does not arm while it moves.
        page.until(lambda: not page.ask("take_off").get("error"))
        assert page.state == "closed_loop"
        page.stop()


def test_land_ends_a_plan_and_the_log_says_so(served: Served) -> None:
    with SocketPage(served.address) as page:
        number = page.send("fly", plans=["hover"])
        page.until(lambda: (page.known["status"]["flight"] or {}).get("phase") == "hover")
        assert "error" in page.ask("setpoint", travel_deg=5.0)
        assert "error" in page.ask("record", on=False)
        page.ask("mark", text="now it lands")
        page.ask("land")
        assert page.answer(number)["outcome"].startswith("aborted: the board went to state landing")
        log = read_log(served.logs()[0])
        assert ("mark", "now it lands") in [(event["name"], event["message"]) for event in log.events]
        assert log.metadata["result"]["outcome"].startswith("aborted")


def test_recording_goes_on_and_off_with_marks_and_setpoints_by_hand(served: Served) -> None:
    with SocketPage(served.address) as page:
        page.ask("record", on=True)
        page.ask("take_off", elevation_deg=-5.0)
        page.ask("setpoint", travel_deg=6.0)
        page.ask("mark")
        page.until(lambda: abs(served.heli.latest.travel_deg - 6.0) < 1.0)
        page.ask("set", name="travel_kp", value=0.65)
        page.ask("record", on=False)
        page.stop()
        log = read_log(served.logs()[0])
        logged_events = [(event["name"], event["message"]) for event in log.events]
        assert ("mark", "mark 1") in logged_events
        assert ("parameter", "travel_kp: 0.6 -> 0.65") in logged_events
        assert log.metadata["parameters_changed"] == {"travel_kp": "0.65"}


def test_a_second_program_joins_tunes_and_flies_once_it_is_let(served: Served) -> None:
    with SocketPage(served.address) as page, heli_host.join(served.address.program) as program:
        assert not program.flies
        with pytest.raises(PageError, match="page 1 is the pilot, and you watch"):
            program.set("travel_kp", 0.7)
        page.ask("share", on=True)
        assert program.set("travel_kp", 0.7) == 0.7
        assert program.params["travel_kp"] == 0.7
        page.ask("take_off")
        program.wait_for_state(State.CLOSED_LOOP)
        program.signal("error", 1.5)
        page.until(lambda: any(message.get("signal", {}).get("value") == 1.5 for message in list(page.words)))
        flown = program.samples(last_s=1.0)
        assert len(flown) == 1000
        assert (np.diff(flown.tick) == 1).all()
        # Answered first: a grant that arrives after the request would grant it.
        page.ask("grant")
        assert not program.ask_control(timeout_s=0.2)
        page.ask("grant")
        page.until(lambda: program.flies)
        program.setpoint(travel_deg=3.0)
        program.stop()
        program.wait_for_state(State.IDLE)


def test_a_server_that_is_killed_is_a_missing_setpoint_and_the_board_lands(tmp_path: Path) -> None:
    with SilProcess(rig="makki2024", speed=1.0) as board:
        with page_process("--port", board.url, folder=tmp_path) as (server, url):
            parts = urlsplit(url)
            token = parts.query.removeprefix("token=")
            assert parts.port is not None
            with SocketPage(Address("127.0.0.1", parts.port, token)) as page:
                page.ask("take_off")
                server.kill()
                server.wait()
        with heli_host.connect(board.url, keep_alive=False) as heli:
            # The cause of the landing stays in telemetry until the next take-off.
            landed = heli.wait_until(lambda sample: sample.state is State.IDLE, 60.0)
            assert landed.trigger is Trigger.STALE_LAND


def test_ctrl_c_at_the_server_lands(tmp_path: Path) -> None:
    with page_process("--sil", folder=tmp_path) as (server, url):
        parts = urlsplit(url)
        assert parts.port is not None
        address = Address("127.0.0.1", parts.port, parts.query.removeprefix("token="))
        with SocketPage(address) as page:
            page.ask("take_off")
            server.send_signal(signal.SIGINT)
            page.until_state("landing")
            assert server.stdout is not None
            output = server.stdout.read()
    assert "landing; Ctrl-C stops the motors" in output
    assert "landed" in output
    assert server.returncode == 0


@pytest.mark.parametrize("path", OWN, ids=lambda path: path.name)
def test_nothing_is_loaded_from_elsewhere(path: Path) -> None:
    addresses = set(re.findall(r"(?:https?:)?//[\w.-]+\.\w+[^\s\"')]*", path.read_text()))
    assert addresses <= {"http://www.w3.org/2000/svg"}


def test_the_policy_lets_a_page_load_from_its_server_only() -> None:
    policy = page_file("", {}).headers["content-security-policy"]
    sources = {word for rule in policy.split(";") for word in rule.split()[1:]}
    assert sources == {"'none'", "'self'"}


def test_every_file_that_the_page_names_is_there() -> None:
    for path in OWN:
        text = path.read_text()
        named = re.findall(r'(?:src|href)="([\w./]+)"', text) + re.findall(r'from "\./([\w./]+)"', text)
        named += re.findall(r'new Worker\("([\w./]+)"', text)
        for name in named:
            assert page_file(name, {}).status_code == 200, f"{path.name} names {name}"


@pytest.mark.parametrize("name", [name for entry in pinned().values() for name in entry["files"]])
def test_what_others_wrote_is_there_with_its_licence(name: str) -> None:
    data = stored(name).read_bytes()
    text = (gzip.decompress(data) if stored(name).suffix == ".gz" else data).decode()
    assert len(text) > 500
    if name.endswith("LICENSE"):
        assert "Permission is hereby granted, free of charge" in text


def test_a_browser_that_takes_no_gzip_gets_plain_text() -> None:
    plain = page_file("vendor/three.js", {})
    packed = page_file("vendor/three.js", {"accept-encoding": "gzip, deflate"})
    assert gzip.decompress(bytes(packed.body)) == bytes(plain.body)
    assert packed.headers["content-encoding"] == "gzip"


@pytest.mark.parametrize("package", pinned())
def test_what_others_wrote_is_what_npm_has_under_the_pinned_hash(package: str) -> None:
    entry = pinned()[package]
    try:
        with urllib.request.urlopen(entry["url"], timeout=30) as answer:
            tarball = answer.read()
    except (urllib.error.URLError, TimeoutError) as error:
        pytest.skip(f"skipped: npm cannot be reached ({error})")
    assert integrity(tarball) == entry["integrity"]
    for name, data in unpacked(tarball, entry["files"]).items():
        kept = stored(name).read_bytes()
        assert (gzip.decompress(kept) if stored(name).suffix == ".gz" else kept) == data
