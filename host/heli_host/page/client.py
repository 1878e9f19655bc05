"""A second program in a flying session: what a notebook uses beside the page that flies.

The page's server has one socket for pages and programs; docs/page.md describes it for other languages.
"""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Mapping
from types import MappingProxyType, TracebackType
from typing import Any, Final, Self
from urllib.parse import parse_qs, urlsplit

import numpy as np
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from heli_host.declaration import State
from heli_host.errors import HeliError, LinkError, PortError
from heli_host.link.clock import TICK_S
from heli_host.page.source import KEPT_S
from heli_host.page.tape import Tape
from heli_host.page.wire import RESET, unpack
from heli_host.samples import Samples, Scales

SCHEME: Final = "page://"

_ANSWER_S = 10.0
_OPEN_S = 5.0


class PageError(HeliError):
    """The page's server refused what was asked of it; cause and remedy are its own."""

    exit_code = 3


class Joined:
    """A program beside a page; `join` makes one. It watches, tunes where it may, and flies once it is let.

    Use it in a ``with`` block. Its own thread answers the server, so as a pilot it counts as present while
    the process lives.

    Parameters
    ----------
    opened : ExitStack
        Closes the socket.
    socket : ClientConnection
        Open, and let in.
    stop_address : str
        Where the stop goes.
    """

    def __init__(self, opened: contextlib.ExitStack, socket: ClientConnection, stop_address: str) -> None:
        self._opened, self._socket = opened, socket
        self._stop_address = stop_address
        self._tape = Tape(round(KEPT_S / TICK_S))
        self._known: dict[str, Any] = {}
        self._values: dict[str, float] = {}
        self._answers: dict[int, Mapping[str, Any]] = {}
        self._number = 0
        self._over = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._read, name="heli-host joined", daemon=True)
        self._thread.start()
        if not self._wait(lambda: "hello" in self._known and "seats" in self._known, _OPEN_S):
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
        """The board's parameters; `set` changes one."""
        return MappingProxyType(self._values)

    @property
    def state(self) -> State:
        """State of the board's supervisor, up to half a second old while nothing changes."""
        return State(self._known["status"]["state"])

    @property
    def status(self) -> Mapping[str, Any]:
        """What the page shows in words: state, fault, link, recording, flight."""
        return MappingProxyType(dict(self._known["status"]))

    @property
    def flies(self) -> bool:
        """Whether this program is the pilot."""
        return bool(self._known["seats"]["pilot"] == self._known["hello"]["you"])

    def samples(self, last_s: float = 10.0) -> Samples:
        """Return the newest samples that came, oldest first; every tick while this program keeps up.

        Parameters
        ----------
        last_s : float
            How much device time [s].
        """
        cut = self._tape.cut(max(self._tape.end - round(last_s / TICK_S), 0), round(KEPT_S / TICK_S))
        return Scales(self._values).samples(cut.tick, cut.raw)

    def set(self, name: str, value: float) -> float:
        """Set a parameter in the board's memory; return the value now in force.

        Parameters
        ----------
        name : str
            As declared in link.toml.
        value : float
            New value, in the unit of the declaration.

        Raises
        ------
        PageError
            This program neither flies nor may tune, or the board refused.
        """
        return float(self.ask("set", name=name, value=value)["value"])

    def ask_control(self, timeout_s: float = 30.0) -> bool:
        """Ask the pilot for control, and wait for the answer; True when this program flies now.

        Parameters
        ----------
        timeout_s : float
            Longest wait [s].
        """
        if self.ask("ask").get("granted"):
            return True
        mine = self._known["hello"]["you"]
        self._wait(lambda: self.flies or self._known["seats"]["asking"] != mine, timeout_s)
        return self.flies

    def setpoint(self, *, elevation_deg: float | None = None, travel_deg: float | None = None) -> None:
        """Send a setpoint; what is not given stays as it was. Only as the pilot.

        Parameters
        ----------
        elevation_deg, travel_deg : float or None
            Targets [deg].
        """
        given = {"elevation_deg": elevation_deg, "travel_deg": travel_deg}
        self.ask("setpoint", **{name: value for name, value in given.items() if value is not None})

    def mark(self, text: str) -> None:
        """Write a mark into the log that is being recorded, and on every page.

        Parameters
        ----------
        text : str
            Its words.
        """
        self.ask("mark", text=text)

    def signal(self, name: str, value: float) -> None:
        """Show a value of this program's own on every page, in a strip, and write it into the log.

        Parameters
        ----------
        name : str
            Of the signal.
        value : float
            Its value now.

        Raises
        ------
        PageError
            The value is not finite.
        """
        self.ask("signal", name=name, value=float(value))

    def stop(self) -> None:
        """Switch the motors off, before everything else; needs no control.

        Raises
        ------
        LinkError
            The server does not answer.
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
        """Ask for anything in the table of docs/page.md, and wait for the answer.

        Parameters
        ----------
        name : str
            What, such as ``take_off``.
        timeout_s : float
            Longest wait [s].
        **arguments : object
            What it takes.

        Raises
        ------
        PageError
            It was refused.
        LinkError
            The server is gone, or did not answer in time.
        """
        with self._changed:
            self._number += 1
            number = self._number
        try:
            self._socket.send(json.dumps({"do": name, "id": number, **arguments}))
        except WebSocketException as error:
            raise LinkError("the dashboard has ended", "start it again") from error
        if not self._wait(lambda: number in self._answers, timeout_s):
            raise LinkError(
                f"the dashboard did not answer {name} within {timeout_s:g} s",
                "wait until its current action ends, then try again",
            )
        answer = self._answers.pop(number)
        if "error" in answer:
            raise PageError(str(answer["error"]), str(answer.get("remedy", "")))
        return answer

    def wait_for_state(self, *states: State, timeout_s: float = 30.0) -> State:
        """Wait until the board is in one of some states; returns it.

        Parameters
        ----------
        *states : State
            Which.
        timeout_s : float
            Longest wait [s].

        Raises
        ------
        LinkError
            It was in none of them in time.
        """
        if not self._wait(lambda: self.state in states, timeout_s):
            names = " or ".join(str(state) for state in states)
            raise LinkError(
                f"the board is {self.state}, not {names}, after {timeout_s:g} s",
                "read its events for the reason",
            )
        return self.state

    def close(self) -> None:
        """Leave; what flies goes on flying, unless this program was the pilot."""
        with contextlib.suppress(WebSocketException, OSError):
            self._opened.close()
        if threading.current_thread() is not self._thread:
            self._thread.join(_OPEN_S)

    def _wait(self, so: Any, timeout_s: float) -> bool:
        end_s = time.monotonic() + timeout_s
        with self._changed:
            while not so():
                left_s = end_s - time.monotonic()
                if left_s <= 0.0 or self._over:
                    return False
                self._changed.wait(left_s)
        return True

    def _read(self) -> None:
        with contextlib.suppress(WebSocketException, OSError):
            for message in self._socket:
                if isinstance(message, bytes):
                    self._take_rows(message)
                else:
                    self._take_words(json.loads(message))
                with self._changed:
                    self._changed.notify_all()
        with self._changed:
            self._over = True
            self._changed.notify_all()

    def _take_rows(self, frame: bytes) -> None:
        rows = unpack(frame)
        if rows.flags & RESET and len(rows.tick):
            self._tape.clear()
        self._tape.append(rows.tick, np.ascontiguousarray(rows.raw))
        self._socket.send(rows.number.to_bytes(4, "little"))

    def _take_words(self, words: Mapping[str, Any]) -> None:
        with self._changed:
            if "answer" in words and words["answer"] is not None:
                self._answers[int(words["answer"])] = words
            for name in ("hello", "status", "seats"):
                if name in words:
                    self._known[name] = words[name]
            values = words.get("values", words.get("hello", {}).get("values"))
            if values is not None:
                self._values = values


def join(address: str) -> Joined:
    """Join a session that a page shows, from another program.

    Parameters
    ----------
    address : str
        ``page://127.0.0.1:8000/?token=...``, as ``heli-host dashboard`` prints it.

    Returns
    -------
    Joined
        Use it in a ``with`` block.

    Raises
    ------
    LinkError
        Nobody serves there, or the token is wrong.

    Examples
    --------
    >>> with heli_host.join("page://127.0.0.1:8000/?token=...") as flight:
    ...     flight.set("travel_kp", 0.7)
    ...     flown = flight.samples(last_s=20.0)
    """
    parts = urlsplit(address)
    token = parse_qs(parts.query).get("token", [""])[0]
    if not address.startswith((SCHEME, "http://")) or not token:
        raise PortError(
            f"{address} is not the address of a dashboard",
            "give the whole address that heli-host dashboard printed",
        )
    base = f"ws://{parts.netloc}"
    with contextlib.ExitStack() as opened:
        address = f"{base}/ws?role=program&token={token}"
        try:
            socket = opened.enter_context(
                connect(address, open_timeout=_OPEN_S, compression=None, proxy=None)
            )
        except (OSError, TimeoutError, WebSocketException) as error:
            raise LinkError(
                f"{parts.netloc} refuses the connection",
                "check that heli-host dashboard runs, and give its whole address",
            ) from error
        return Joined(opened.pop_all(), socket, f"{base}/stop?token={token}")
