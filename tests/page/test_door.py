"""Any message to the server of the page gets one line as answer, and no client misses the status."""

import json
import math
import time
from collections.abc import Iterator
from typing import Any

import heli_host
import pytest
from heli_host.fly.plan import Plan
from heli_host.ui.page import clients
from heli_host.ui.page.cockpit import Cockpit
from heli_host.ui.page.replay import Replay
from heli_host.ui.page.requests import BadRequest, read_request
from heli_host.ui.page.serve import Address, serving
from heli_host.ui.page.telemetry import pack
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip("starlette", reason="the extra 'page' is not installed: make setup")

from heli_host.data.log.reader import read_log

from tests.page.hostile_requests import ARGUMENTS, FAR, UPGRADE, status_of_request
from tests.page.page_server import (
    PATIENCE_S,
    SHORT_PLAN,
    Served,
    SocketPage,
    log_lines,
    page_of_a_simulated_board,
    steady,
    traces,
)
from tests.running.long import samples
from tests.running.order import REAL_TIME

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group(REAL_TIME)]

PILOT = "pilot"
"""Id of the page that flies: a pilot keeps the seat from one test to the next."""
NOT_FINITE = ("NaN", "Infinity", "-Infinity", "1e999", "9" * 400, "-" + "9" * 400)


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with page_of_a_simulated_board(tmp_path_factory.mktemp("door"), laws=[steady().program]) as page_server:
        yield page_server


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Address]:
    path = tmp_path_factory.mktemp("replay") / "flight.mcap"
    with heli_host.connect("sil://?speed=max") as heli:
        heli.fly(Plan.parse(SHORT_PLAN, "short"), log=path)
    with serving(Replay(read_log(path), {})) as address:
        yield address


def pilot_page(served: Served) -> SocketPage:
    """Open the page that flies; again, if the server has not yet seen that its last tab was closed."""
    end_s = time.monotonic() + PATIENCE_S
    while not (page := SocketPage(served.address, PILOT)).flies:
        page.close()
        assert time.monotonic() < end_s, "the server never saw that the pilot's last tab was closed"
    return page


def until_next_status(page: SocketPage) -> None:
    """Wait for two more statuses: the first may have been on its way."""
    before = sum("status" in words for words in list(page.words))
    page.until(lambda: sum("status" in words for words in list(page.words)) >= before + 2)


def test_every_action_refuses_what_is_no_finite_number(served: Served) -> None:
    with pilot_page(served) as page, SocketPage(served.address) as other, log_lines() as lines:
        for action, arguments in ARGUMENTS.items():
            for argument in arguments or ("extra",):
                for text in NOT_FINITE:
                    page.wait_for_turn()
                    page.number += 1
                    named = "".join(f'"{name}": "kp", ' for name in arguments if name != argument)
                    page.socket.send(
                        f'{{"do": "{action}", "id": {page.number}, {named}"{argument}": {text}}}'
                    )
                    error = page.answer(page.number)["error"]
                    assert error.startswith(f"{argument} is ") and error.endswith("not a finite number")
        until_next_status(page)
        until_next_status(other)
    assert not traces(lines)


def test_an_id_that_cannot_be_answered_is_refused(served: Served) -> None:
    with pilot_page(served) as page:
        for number in (*NOT_FINITE, "[[]]", "true", f'"{"x" * 101}"'):
            page.socket.send(f'{{"do": "hold", "id": {number}}}')
        page.until(lambda: sum("error" in words for words in page.words) == len(NOT_FINITE) + 3)
        assert all(words["answer"] is None for words in page.words if "error" in words)
        until_next_status(page)


def test_a_take_off_to_nowhere_arms_nothing(served: Served) -> None:
    with pilot_page(served) as page:
        for elevation_deg in (90.0, -90.0, 1e308):
            assert "outside the board's limits" in page.ask("take_off", elevation_deg=elevation_deg)["error"]
        until_next_status(page)
        assert page.state == "idle"


def test_a_status_that_cannot_be_written_is_logged_once_and_sent_later(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    status = Cockpit.status

    def odd(cockpit: Cockpit) -> dict[str, Any]:
        return {**status(cockpit), **extra}

    def fails(cockpit: Cockpit) -> dict[str, Any]:
        raise KeyError("a defect")

    with pilot_page(served) as page, log_lines() as lines:
        extra: dict[str, Any] = {"twin": {"ghost_rad": [math.nan, 0.0]}}
        monkeypatch.setattr(Cockpit, "status", odd)
        page.until(lambda: page.known["status"]["twin"] == {"ghost_rad": [None, 0.0]})
        extra = {"twin": object()}
        page.until(lambda: len(lines) == 2)
        monkeypatch.setattr(Cockpit, "status", fails)
        page.until(lambda: len(lines) == 3)
        monkeypatch.setattr(Cockpit, "status", status)
        until_next_status(page)
    assert lines == [
        "page: status holds a number that is not finite; pages get null",
        "page: status cannot be sent: TypeError: Object of type object is not JSON serializable",
        "page: the status cannot be read: KeyError: 'a defect'",
    ]


def test_a_client_whose_frames_cannot_be_sent_is_disconnected_and_the_others_go_on(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    failed: list[int] = []

    def fails_once(*arguments: Any) -> bytes:
        if not failed:
            failed.append(1)
            raise ValueError("a defect")
        return pack(*arguments)

    with pilot_page(served) as first, SocketPage(served.address) as second, log_lines() as lines:
        monkeypatch.setattr(clients, "pack", fails_once)
        first.until(lambda: first.socket.close_code is not None or second.socket.close_code is not None)
        gone, other = (first, second) if first.socket.close_code is not None else (second, first)
        assert gone.socket.close_code == 1011
        until_next_status(other)
        other.until(lambda: other.known["control"]["clients"] == 1)
    (line,) = lines
    assert line.startswith("page: page ") and line.endswith(" is disconnected: ValueError: a defect")


def test_frames_carry_the_state_even_without_rows(served: Served) -> None:
    with pilot_page(served) as page:
        page.until(lambda: bool(page.rows))
        until_next_status(page)
        assert page.rows[-1].state == page.known["status"]["state"] == 0


ODD = st.one_of(
    st.sampled_from([*FAR, math.nan, math.inf, 10**400, -(10**309), "\ud800", "\0", None, True]),
    st.text(max_size=20),
    st.floats(),
    st.recursive(st.none(), lambda inner: st.lists(inner, max_size=2), max_leaves=4),
)


@st.composite
def requests(draw: st.DrawFn) -> dict[str, Any]:
    name = draw(st.sampled_from(sorted(ARGUMENTS)))
    arguments = {argument: draw(ODD) for argument in ARGUMENTS[name]}
    if "name" in arguments and draw(st.booleans()):
        arguments["name"] = draw(st.sampled_from(["travel_kp", "kp", "steady"]))
    if name == "take_off":
        # The others would fly.
        arguments["elevation_deg"] = draw(st.sampled_from([*FAR[:4], math.nan, "up", None]))
    return {"do": name, **arguments, **draw(st.dictionaries(st.text(max_size=5), ODD, max_size=2))}


@settings(max_examples=samples(600, 60), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(wishes=st.lists(requests(), min_size=1, max_size=8))
def test_any_request_is_answered_once_and_none_fails_inside(
    served: Served, wishes: list[dict[str, Any]]
) -> None:
    with pilot_page(served) as page, log_lines() as lines:
        for number, wish in enumerate(wishes, 1):
            page.socket.send(json.dumps({**wish, "do": wish["do"], "id": number}))
        for number in range(1, len(wishes) + 1):
            page.answer(number)
        page.number = len(wishes)
        assert "error" in page.ask("explode")
        answers = [words["answer"] for words in page.words if "answer" in words]
        assert sorted(answers) == sorted(set(answers))
    assert not traces(lines)
    assert not [line for line in lines if "failed" in line or "cannot" in line or "disconnected" in line]


@settings(deadline=None)
@given(st.one_of(st.text(max_size=200), st.recursive(ODD, st.lists).map(json.dumps), st.just("[" * 4000)))
def test_a_message_is_a_request_or_is_refused_in_words(words: str) -> None:
    try:
        request = read_request(words)
    except BadRequest as error:
        assert error.cause and error.remedy
    else:
        assert isinstance(request.name, str)


def test_what_was_an_internal_error_is_refused_in_one_line(replayed: Address) -> None:
    host = ("Host", f"127.0.0.1:{replayed.port}")
    page, token = f"/?token={replayed.token}", replayed.token
    with log_lines() as lines:
        # Without the token nothing else is looked at.
        assert status_of_request(replayed, "/", [("Host", "[")]) == 403
        assert status_of_request(replayed, "/stop?token=no", [("Host", "[")], "POST") == 403
        assert not lines
        assert status_of_request(replayed, page, [("Host", "[")]) == 400
        assert status_of_request(replayed, "/main.js", [("Host", "[")]) == 400
        assert status_of_request(replayed, page, [host, ("Origin", "http://[")]) == 403
        assert (
            status_of_request(replayed, f"/stop?token={token}", [host, ("Origin", "http://[")], "POST") == 403
        )
        assert status_of_request(replayed, f"/ws?token={token}", [("Host", "["), *UPGRADE]) == 403
        assert status_of_request(replayed, f"/{'x' * 9000}.js", [host]) == 414
        assert status_of_request(replayed, f"/{'x' * 150}/{'%00' * 10}.js", [host]) == 404
        assert status_of_request(replayed, page, [host]) == 200
    assert lines == [
        "page: a request of 127.0.0.1 is refused: its Host header is '['",
        "page: a request of 127.0.0.1 is refused: its Origin header is 'http://['",
        "page: a request of 127.0.0.1 is refused: its path has 9004 characters",
    ]


TOKENS = ["", "?token=", "?token=%ff", "?token=[", "?token={}", "?token={}&client=%00&rows=x"]
WORDS = st.text(st.characters(codec="latin-1", exclude_characters="\r\n"), max_size=40)
HOSTS = st.one_of(WORDS, st.sampled_from(["[", "]", "[::1", "[::1]:x", "127.0.0.1", "localhost:99999999999"]))
ORIGINS = st.one_of(WORDS, HOSTS.map("http://{}".format), st.just("null"))
PATHS = st.one_of(
    st.sampled_from(["", "stop", "ws", "main.js", "vendor/three.js", "../cockpit.py", "%00", "a" * 9000]),
    st.text(st.characters(codec="ascii", categories=["L", "N", "P"]), max_size=40),
)


@settings(max_examples=samples(2000, 150), deadline=None)
@given(
    path=PATHS,
    token=st.sampled_from(TOKENS),
    host=st.none() | HOSTS,
    origin=st.none() | ORIGINS,
    method=st.sampled_from(["GET", "POST", "HEAD", "PUT", "OPTIONS"]),
    upgrade=st.booleans(),
)
def test_no_request_of_anybody_is_an_internal_error(
    replayed: Address, path: str, token: str, host: str | None, origin: str | None, method: str, upgrade: bool
) -> None:
    good = f"127.0.0.1:{replayed.port}"
    headers = [("Host", good if host is None else host)]
    headers += [("Origin", origin)] if origin is not None else []
    with log_lines() as lines:
        status = status_of_request(
            replayed,
            f"/{path}{token.format(replayed.token)}",
            headers + (UPGRADE if upgrade else []),
            "GET" if upgrade else method,
        )
    assert status < 500
    assert not traces(lines)
    if path in ("", "stop", "ws") and replayed.token not in token.format(replayed.token):
        assert 400 <= status < 500 or status == 0
