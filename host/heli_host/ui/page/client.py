"""Client of a page's server: a program, such as a notebook, watches and commands the board of the page.

Pages and programs use the same WebSocket; docs/how-to/dashboard.md describes it for other languages.
"""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Callable, Mapping
from types import MappingProxyType, TracebackType
from typing import Any, Final, Self
from urllib.parse import parse_qs, urlsplit

import numpy as np
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from heli_host.board.samples import Samples, Scales
from heli_host.declaration import State
from heli_host.errors import HeliError, LinkError, PortError, printable
from heli_host.link.clock import TICK_S
from heli_host.ui.page.guard import MESSAGES_PER_S, POLICY_VIOLATION, RateLimit
from heli_host.ui.page.requests import LONGEST_REQUEST
from heli_host.ui.page.source import KEPT_S, finite
from heli_host.ui.page.telemetry import RESET, TelemetryBuffer, unpack

_SCHEME: Final = "page://"

_REQUESTS_PER_S = MESSAGES_PER_S / 2
"""Requests that a program sends per second [1/s]: the server disconnects faster ones. The other half is for
the acknowledgements of telemetry, which the background thread sends."""
_ANSWER_S = 10.0
_OPEN_S = 5.0
# The system refuses to wait for infinity.
_LOOK_S = 60.0


class PageError(HeliError):
    """The page's server refused a request; the message is the one that the server sent."""

    exit_code = 3


class PageClient:
    """A program that is connected to a page's server; `join` makes one.

    It receives telemetry, may change parameters if the pilot shares that, and flies after `ask_control`. Use
    it in a ``with`` block, from one thread. A background thread acknowledges the telemetry. Therefore a
    program that is the pilot counts as present as long as its process lives, even if its own code hangs; the
    stop of every page still works.
    """

    def __init__(self, resources: contextlib.ExitStack, socket: ClientConnection, stop_address: str) -> None:
        self._resources = resources  # The socket and all else that `close` releases
        self._socket = socket
        self._stop_address = stop_address
        self._buffer = TelemetryBuffer(round(KEPT_S / TICK_S))
        # Messages of the server; `_changed` guards them, and wakes callers that wait for one.
        self._changed = threading.Condition()
        self._newest: dict[str, Any] = {}  # Newest message of a kind: hello, status or control
        self._parameters: dict[str, float] = {}  # Parameters of the board by name
        self._answers: dict[int, Mapping[str, Any]] = {}  # By number of the request
        self._is_closed = False
        self._last_request = 0
        self._request_limit = RateLimit(_REQUESTS_PER_S, _REQUESTS_PER_S)
        self._reader = threading.Thread(target=self._read_until_closed, name="heli-host joined", daemon=True)
        self._reader.start()
        if not self._wait_until(lambda: "hello" in self._newest and "control" in self._newest, _OPEN_S):
            self.close()
            raise LinkError("the dashboard refused the connection", "give the whole address that it printed")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def params(self) -> Mapping[str, float]:
        """The board's parameters by name, read-only; `set` changes one."""
        return MappingProxyType(self._parameters)

    @property
    def state(self) -> State:
        """State of the board's supervisor, at most about 0.5 s old."""
        state = self._newest["status"]["state"]
        if state not in list(State):
            raise LinkError("no sample has come from the board yet", "wait a moment, then try again")
        return State(state)

    @property
    def status(self) -> Mapping[str, Any]:
        """Newest status that the server sent: state, fault, link, recording, flight."""
        return MappingProxyType(dict(self._newest["status"]))

    @property
    def flies(self) -> bool:
        """Whether this program is the pilot."""
        return bool(self._newest["control"]["pilot"] == self._newest["hello"]["you"])

    def samples(self, last_s: float = 10.0) -> Samples:
        """Return the newest samples, oldest first: one per tick of 1 ms, or fewer if this program is slow."""
        count = round(min(max(finite("last_s", last_s), 0.0), KEPT_S) / TICK_S)
        cut = self._buffer.rows_since(max(self._buffer.end - count, 0), round(KEPT_S / TICK_S))
        return Scales(self._parameters).samples(cut.tick, cut.raw)

    def set(self, name: str, value: float) -> float:
        """Set a parameter of the board, in memory only, and return the value in force."""
        return float(self.ask("set", name=name, value=value)["value"])

    def ask_control(self, timeout_s: float = 30.0) -> bool:
        """Ask the pilot for control and wait for the answer."""
        if self.ask("ask").get("granted"):
            return True
        own_key = self._newest["hello"]["you"]
        self._wait_until(lambda: self.flies or self._newest["control"]["asking"] != own_key, timeout_s)
        return self.flies

    def setpoint(self, *, elevation_deg: float | None = None, travel_deg: float | None = None) -> None:
        """Send a setpoint. Only the pilot may."""
        targets = {"elevation_deg": elevation_deg, "travel_deg": travel_deg}
        self.ask("setpoint", **{name: value for name, value in targets.items() if value is not None})

    def mark(self, text: str) -> None:
        """Write a mark into the log, if one is recorded, and show it on every page."""
        self.ask("mark", text=text)

    def signal(self, name: str, value: float) -> None:
        """Plot a value of this program on every page, and write it into the log, if one is recorded."""
        self.ask("signal", name=name, value=value)

    def stop(self) -> None:
        """Switch both motors off, ahead of all other commands. Every client may. An arm in the air falls.

        Opens a separate socket, which the server handles in a separate thread. The call returns after the
        server has sent the stop to the board. May be called from any thread.
        """
        try:
            with connect(self._stop_address, open_timeout=_OPEN_S, compression=None, proxy=None) as socket:
                socket.send("stop")
                answer = socket.recv(_ANSWER_S)
        except (OSError, TimeoutError, WebSocketException) as error:
            raise LinkError("the dashboard does not answer", "use the rig's own stop switch") from error
        if answer != "stopped":
            raise LinkError(str(answer), "use the rig's own stop switch")

    def ask(self, name: str, /, *, timeout_s: float = _ANSWER_S, **arguments: Any) -> Mapping[str, Any]:
        """Send a request of the table in docs/how-to/dashboard.md and wait for the answer."""
        # At most 50 requests are sent per second; a further one waits for its turn.
        with self._changed:
            self._last_request += 1
            number = self._last_request
        text = _as_json({**arguments, "do": name, "id": number})
        while not self._request_limit.take():
            time.sleep(self._request_limit.wait_s())
        try:
            self._socket.send(text)
        except WebSocketException as error:
            if self._socket.close_code == POLICY_VIOLATION:
                cause = f"the dashboard disconnected this program: {self._socket.close_reason}"
                raise LinkError(cause, "then join again") from error
            raise LinkError("the dashboard has ended", "start it again") from error
        if not self._wait_until(lambda: number in self._answers, timeout_s):
            raise LinkError(
                f"the dashboard did not answer {name} within {timeout_s:g} s",
                "wait until its current action ends, then try again",
            )
        answer = self._answers.pop(number)
        if "error" in answer:
            raise PageError(str(answer["error"]), str(answer.get("remedy", "")))
        return answer

    def wait_for_state(self, *states: State, timeout_s: float = 30.0) -> State:
        """Wait until the board is in one of the given `states`, and return that state."""
        if not self._wait_until(lambda: self._newest["status"]["state"] in states, timeout_s):
            names = " or ".join(str(state) for state in states)
            raise LinkError(
                f"the board is {self.state}, not {names}, after {timeout_s:g} s",
                "read its events for the reason",
            )
        return self.state

    def close(self) -> None:
        """Disconnect. The motors are not touched. If this program was the pilot, the board gets no further
        setpoints: it holds level, then lands.
        """
        with contextlib.suppress(WebSocketException, OSError):
            self._resources.close()
        if threading.current_thread() is not self._reader:
            self._reader.join(_OPEN_S)

    def _wait_until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until `condition` is true; return False if that takes too long, or if the page is gone."""
        end_s = time.monotonic() + timeout_s
        with self._changed:
            while not condition():
                left_s = end_s - time.monotonic()
                # Written so that a time limit of nan counts as passed.
                if not left_s > 0.0 or self._is_closed:
                    return False
                self._changed.wait(min(left_s, _LOOK_S))
        return True

    def _read_until_closed(self) -> None:
        """Read messages of the server until it closes, in a thread of its own."""
        with contextlib.suppress(WebSocketException, OSError):
            for message in self._socket:
                if isinstance(message, bytes):
                    self._store_rows(message)
                else:
                    self._store_message(json.loads(message))
                with self._changed:
                    self._changed.notify_all()
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    def _store_rows(self, frame: bytes) -> None:
        """Add the rows of a frame to the buffer, and acknowledge the frame."""
        rows = unpack(frame)
        if rows.flags & RESET and len(rows.tick):
            self._buffer.clear()
        self._buffer.append(rows.tick, np.ascontiguousarray(rows.raw))
        self._socket.send(rows.number.to_bytes(4, "little"))

    def _store_message(self, message: Mapping[str, Any]) -> None:
        """Store what a JSON message of the server contains: an answer, status, control or values."""
        with self._changed:
            if "answer" in message and message["answer"] is not None:
                self._answers[int(message["answer"])] = message
            for name in ("hello", "status", "control"):
                if name in message:
                    self._newest[name] = message[name]
            values = message.get("values", message.get("hello", {}).get("values"))
            if values is not None:
                self._parameters = values


def _as_json(request: Mapping[str, Any]) -> str:
    """Return a request as JSON; a PageError reports one that JSON cannot hold or that is too long."""
    try:
        text = json.dumps(request)
    except (TypeError, ValueError, RecursionError) as error:
        raise PageError(f"JSON cannot hold the request: {error}", "give numbers, texts and lists") from None
    # The server does not parse a longer request, so that it cannot answer with the number of the request.
    if len(text) > LONGEST_REQUEST:
        raise PageError(f"a request of {len(text)} characters is too long", f"send at most {LONGEST_REQUEST}")
    return text


def join(address: str) -> PageClient:
    """Connect this program to the server of a page, and thereby to its board.

    Parameters
    ----------
    address : str
        ``page://127.0.0.1:8000/?token=...``, as ``heli-host dashboard`` prints it.

    Returns
    -------
    PageClient
        Connected; use it in a ``with`` block.

    Raises
    ------
    PortError
        The address is not that of a page, or lacks the token.
    LinkError
        No server answers at the address, or the token is wrong.

    Examples
    --------
    >>> with heli_host.join("page://127.0.0.1:8000/?token=...") as flight:
    ...     flight.set("travel_kp", 0.7)
    ...     flown = flight.samples(last_s=20.0)
    """
    try:
        url = urlsplit(address)
        token = parse_qs(url.query).get("token", [""])[0]
        has_server = bool(url.hostname) and url.port != 0
    # urlsplit raises ValueError for an unbalanced bracket, and for a port above 65535.
    except ValueError:
        has_server = False
    if not has_server or not token or not address.startswith((_SCHEME, "http://")):
        raise PortError(
            f"{printable(address)} is not the address of a dashboard",
            "give the whole address that heli-host dashboard printed",
        )
    base = f"ws://{url.netloc}"
    with contextlib.ExitStack() as stack:
        socket_address = f"{base}/ws?role=program&token={token}"
        try:
            socket = stack.enter_context(
                connect(socket_address, open_timeout=_OPEN_S, compression=None, proxy=None)
            )
        # UnicodeError: a name that no computer has.
        except (OSError, TimeoutError, WebSocketException, UnicodeError) as error:
            raise LinkError(
                f"{url.netloc} refuses the connection",
                "check that heli-host dashboard runs, and give its whole address",
            ) from error
        return PageClient(stack.pop_all(), socket, f"{base}/stop?token={token}")
