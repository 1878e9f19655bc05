"""A client of Foxglove's WebSocket protocol.

``python -m tests.link.foxglove_viewer ADDRESS`` takes every tick, for the bench. It prints ``ready`` with the
first, and at the end of standard input how many came and how many are missing between them.
"""

from __future__ import annotations

import json
import struct
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

import numpy as np
from heli_host.data.log.schema import EVENT_TOPIC, TICK_TOPIC, parse_layout
from websockets import Subprotocol
from websockets.sync import client

PATIENCE_S = 60.0
_DATA = struct.Struct("<BIQ")


class Message(NamedTuple):
    """A message of a channel, and the time at which the feed sent it."""

    time_ns: int
    body: bytes


class Viewer:
    """A client of the protocol ``foxglove.sdk.v1``, as its specification describes it."""

    def __init__(self, socket: Any) -> None:
        self.socket = socket
        self.waiting: list[bytes] = []
        self.info = json.loads(self.socket.recv(PATIENCE_S))
        self.channels: dict[str, dict[str, Any]] = {}
        while set(self.channels) < {TICK_TOPIC, EVENT_TOPIC}:
            for channel in json.loads(self.socket.recv(PATIENCE_S))["channels"]:
                self.channels[channel["topic"]] = channel

    @classmethod
    @contextmanager
    def of(cls, address: str) -> Iterator[Viewer]:
        with client.connect(address, subprotocols=[Subprotocol("foxglove.sdk.v1")]) as socket:
            yield cls(socket)

    def subscribe(self, topic: str) -> None:
        subscription = {"id": 7, "channelId": self.channels[topic]["id"]}
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))

    def has_message(self) -> bool:
        if not self.waiting:
            with suppress(TimeoutError):
                frame = self.socket.recv(0.05)
                self.waiting += [frame] if isinstance(frame, bytes) else []
        return bool(self.waiting)

    def messages(self, count: int) -> list[Message]:
        """The next messages."""
        got: list[Message] = []
        while len(got) < count:
            frame = self.waiting.pop() if self.waiting else self.socket.recv(PATIENCE_S)
            if isinstance(frame, bytes):
                opcode, subscription, time_ns = _DATA.unpack_from(frame)
                assert (opcode, subscription) == (1, 7)
                got.append(Message(time_ns, frame[_DATA.size :]))
        return got


def main(address: str) -> None:
    """Take ticks until the input ends."""
    has_ended = threading.Event()

    def wait_for_end() -> None:
        sys.stdin.read()
        has_ended.set()

    threading.Thread(target=wait_for_end, daemon=True).start()
    with Viewer.of(address) as viewer:
        viewer.subscribe(TICK_TOPIC)
        layout = parse_layout(viewer.channels[TICK_TOPIC]["schema"])
        bodies = [message.body for message in viewer.messages(1)]
        print("ready", flush=True)
        while not has_ended.is_set():
            if viewer.has_message():
                bodies += [message.body for message in viewer.messages(1)]
    tick = np.frombuffer(b"".join(body[4:] for body in bodies), layout.dtype)["tick"].astype(np.int64)
    print(len(tick), int((np.diff(tick) - 1).sum()), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
