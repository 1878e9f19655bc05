"""A page without a browser: what its script does with its sockets, as slowly as a test wants."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Callable
from typing import Any, Self

from heli_host.ui.page.guard import MESSAGES_PER_S, RateLimit
from heli_host.ui.page.serve import Address
from heli_host.ui.page.telemetry import Rows, unpack
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

PATIENCE_S = 60.0


class SocketPage:
    """One tab. While `answers` is set it acknowledges frames, as a page that lives does."""

    def __init__(self, address: Address, client: str = "", token: str | None = None) -> None:
        base = f"ws://{address.host}:{address.port}"
        token = address.token if token is None else token
        self._opened = contextlib.ExitStack()
        self.socket = self._open(f"{base}/ws?token={token}&client={client}")
        self.stop_socket = self._open(f"{base}/stop?token={token}")
        self.rows: list[Rows] = []
        self.words: list[dict[str, Any]] = []
        self.known: dict[str, Any] = {}
        self.statuses = self.refused_without_number = 0
        self.answers = threading.Event()
        self.answers.set()
        self.number = 0
        self._requests = RateLimit(MESSAGES_PER_S / 2, MESSAGES_PER_S / 2)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        self.until(lambda: "control" in self.known)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._opened.close()
        self._thread.join(5.0)

    def _open(self, address: str) -> ClientConnection:
        return self._opened.enter_context(connect(address, compression=None, proxy=None))

    @property
    def state(self) -> str:
        hello, status = self.known["hello"], self.known["status"]
        return str(hello["states"][str(status["state"])]["name"])

    @property
    def flies(self) -> bool:
        return bool(self.known["control"]["pilot"] == self.known["hello"]["you"])

    def until(self, so: Callable[[], bool]) -> None:
        """Wait for something; how long is nobody's claim, so long as it is not for ever."""
        end_s = time.monotonic() + PATIENCE_S
        while not so():
            assert time.monotonic() < end_s, f"waited in vain; last words: {self.words[-3:]}"
            time.sleep(0.01)

    def until_or(self, so: Callable[[], bool], longest_s: float) -> bool:
        """Wait for something, but not longer than that."""
        end_s = time.monotonic() + longest_s
        while not so():
            if time.monotonic() >= end_s:
                return False
            time.sleep(0.02)
        return True

    def until_state(self, *names: str) -> str:
        self.until(lambda: self.state in names)
        return self.state

    def send(self, name: str, /, **arguments: Any) -> int:
        self.wait_for_turn()
        self.number += 1
        self.socket.send(json.dumps({"do": name, "id": self.number, **arguments}))
        return self.number

    def wait_for_turn(self) -> None:
        """Wait until the server's limit permits one more request, as a hand does without thinking of it."""
        while not self._requests.take():
            time.sleep(self._requests.wait_s())

    def ask(self, name: str, /, **arguments: Any) -> dict[str, Any]:
        return self.answer(self.send(name, **arguments))

    def answer(self, number: int) -> dict[str, Any]:
        def matching() -> list[dict[str, Any]]:
            return [words for words in list(self.words) if words.get("answer") == number]

        self.until(lambda: bool(matching()))
        return matching()[0]

    def stop(self) -> str:
        self.stop_socket.send("stop")
        return str(self.stop_socket.recv(PATIENCE_S))

    def events(self, kind: str) -> list[str]:
        reported = [
            *self.known["hello"]["events"],
            *(message["event"] for message in list(self.words) if "event" in message),
        ]
        return [event["text"] for event in reported if event["kind"] == kind]

    def _read(self) -> None:
        with contextlib.suppress(WebSocketException, OSError):
            for message in self.socket:
                if isinstance(message, bytes):
                    rows = unpack(message)
                    self.rows.append(rows)
                    if self.answers.is_set():
                        self.socket.send(rows.number.to_bytes(4, "little"))
                else:
                    self.take_words(json.loads(message))

    def take_words(self, words: dict[str, Any]) -> None:
        """Take a message that is no telemetry, in the reading thread."""
        self.words.append(words)
        self.statuses += "status" in words
        self.refused_without_number += "error" in words and words.get("answer") is None
        self.known.update({name: words[name] for name in ("hello", "status", "control") if name in words})
