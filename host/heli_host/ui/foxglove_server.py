"""``python -m heli_host.ui.foxglove_server``: serve ticks from standard input to viewers.

It runs in a process of its own, so that viewers take no time from the link or the stop. Each part on
standard input has a header of kind (u8) and size (u32), little-endian. Kinds are the settings as JSON, which
come first, ticks, and events as JSON. The first line on standard output is JSON: the port, or the error. The
end of standard input ends the server. Viewers reach it through a gate, which refuses pages of other origins.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import secrets
import struct
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any, BinaryIO, Final
from urllib.parse import urlsplit

import numpy as np

from heli_host.data.log.schema import (
    CDR_LITTLE_ENDIAN,
    EVENT_SCHEMA,
    EVENT_SCHEMA_NAME,
    EVENT_TOPIC,
    LEVEL_INFO,
    TICK_LAYOUT,
    TICK_SCHEMA,
    TICK_SCHEMA_NAME,
    TICK_TOPIC,
    fill_ticks,
)
from heli_host.data.log.writer import TickClock, json_bytes
from heli_host.declaration import Channel

HOST: Final = "127.0.0.1"
_LOCAL_NAMES: Final = frozenset(("127.0.0.1", "localhost", "::1"))
_VIEWERS: Final = ("https://app.foxglove.dev", "file://")
"""Origins of viewers that are web pages: Foxglove in the browser, and viewers that are installed."""
_MAX_VIEWERS: Final = 16
"""Connections at a time. Each costs up to 4 MB of waiting messages."""
SETTINGS, TICKS, EVENT = 1, 2, 3
HEADER: Final = struct.Struct("<BI")

_LONGEST_HEAD_BYTES: Final = 16384
_HEAD_S: Final = 5.0
_CHUNK_BYTES: Final = 65536
_REFUSED: Final = b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
_BACKLOG: Final = 20_000
"""Messages that wait for one slow client: 20 s of ticks, 4 MB. More: a client that hangs costs memory. Fewer:
a client that pauses for a second, as browsers do, misses samples."""
_NICENESS: Final = 10
"""More than 0, so that viewers wait for the flight; less than 19, with which a busy computer starves them."""
_MESSAGE = np.dtype([("cdr", "<u4"), ("payload", TICK_LAYOUT.dtype)])
_TICK_BYTES: Final = 4 * (1 + len(Channel))


def is_permitted(head: bytes) -> bool:
    """Return whether a request may reach the server."""
    # A browser sends the origin of the page that opens a WebSocket; programs send none. Any page that the
    # user visits could otherwise read the samples. The name of the host must be local, because a foreign name
    # may lead to this computer (DNS rebinding).
    headers: dict[str, list[str]] = {}
    for line in head.decode("latin-1").split("\r\n")[1:]:
        name, _, value = line.partition(":")
        headers.setdefault(name.strip().lower(), []).append(value.strip())
    hosts, origins = headers.get("host", []), headers.get("origin", [])
    if len(hosts) != 1 or len(origins) > 1 or _name(f"//{hosts[0]}") not in _LOCAL_NAMES:
        return False
    return not origins or origins[0] in _VIEWERS or _name(origins[0]) in _LOCAL_NAMES


class _ViewerGate:
    """Accepts viewers in a thread of its own, and passes the permitted ones on."""

    def __init__(self, port: int, inner: tuple[str, int]) -> None:
        self._inner = inner
        self._viewers: set[asyncio.StreamWriter] = set()
        self._loop = asyncio.new_event_loop()
        try:
            self._server = self._loop.run_until_complete(
                asyncio.start_server(self._serve, HOST, port, limit=_LONGEST_HEAD_BYTES)
            )
        except OSError:
            self._loop.close()
            raise
        self.port: int = self._server.sockets[0].getsockname()[1]
        self._thread = threading.Thread(target=self._loop.run_forever, name="viewers", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Accept no more viewers, and end the thread with all connections."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._server.close()
        for writer in self._viewers:
            writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one viewer until either end closes its connection."""
        self._viewers.add(writer)
        inner_writer: asyncio.StreamWriter | None = None
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _HEAD_S)
            if len(self._viewers) > _MAX_VIEWERS or not is_permitted(head):
                writer.write(_REFUSED)
                await writer.drain()
                return
            inner_reader, inner_writer = await asyncio.open_connection(*self._inner)
            inner_writer.write(head)
            directions = [
                asyncio.ensure_future(_copy(reader, inner_writer)),
                asyncio.ensure_future(_copy(inner_reader, writer)),
            ]
            _, waiting = await asyncio.wait(directions, return_when=asyncio.FIRST_COMPLETED)
            for direction in waiting:
                direction.cancel()
            await asyncio.gather(*directions, return_exceptions=True)
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass  # a viewer that is gone, or that sends no request
        finally:
            self._viewers.discard(writer)
            writer.close()
            if inner_writer is not None:
                inner_writer.close()


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Copy bytes until the end; a slow reader at the other end makes this wait."""
    with contextlib.suppress(OSError):
        while data := await reader.read(_CHUNK_BYTES):
            writer.write(data)
            await writer.drain()


def _name(address: str) -> str:
    """Return the name of the host in an address; empty if it is not an address."""
    try:
        return (urlsplit(address).hostname or "").lower()
    except ValueError:
        return ""


class _FoxgloveServer:
    """Publishes ticks and events to all connected viewers, by the topics and layouts of the log."""

    # It advertises no capability: a client can neither publish nor call or set anything.

    def __init__(self, settings: Mapping[str, Any]) -> None:
        import foxglove

        self._start_wall_ns = int(settings["start_wall_ns"])
        self._rad_per_count = np.array(settings["rad_per_count"], np.float64)
        self._clock = TickClock()
        # The context and its channels exist only as long as there is a reference to the context.
        context = self._context = foxglove.Context()
        self._ticks = foxglove.Channel(
            TICK_TOPIC,
            schema=foxglove.Schema(name=TICK_SCHEMA_NAME, encoding="ros2msg", data=TICK_SCHEMA.encode()),
            message_encoding="cdr",
            context=context,
        )
        self._events = foxglove.Channel(
            EVENT_TOPIC,
            schema=foxglove.Schema(name=EVENT_SCHEMA_NAME, encoding="jsonschema", data=EVENT_SCHEMA.encode()),
            message_encoding="json",
            context=context,
        )
        # The SDK accepts pages of any origin. Viewers reach it through a gate only, because it listens on an
        # address of this computer that no page can guess.
        self._server, inner_host = _start_at_secret_address(
            foxglove.start_server,
            name="heli-lab",
            port=0,
            capabilities=[],
            context=context,
            message_backlog_size=_BACKLOG,
        )
        try:
            self._gate = _ViewerGate(int(settings["port"]), (inner_host, self._server.port))
        except OSError as error:
            self._server.stop()
            raise RuntimeError(error.strerror or str(error)) from error
        self.port: int = self._gate.port

    def publish_ticks(self, content: bytes) -> None:
        """Publish a batch of ticks."""
        count = len(content) // _TICK_BYTES
        tick = np.frombuffer(content, "<u4", count)
        raw = np.frombuffer(content, "<i4", count * len(Channel), 4 * count).reshape(count, len(Channel))
        time_us, _ = self._clock.advance(tick)
        if not self._ticks.has_sinks():
            return
        messages = np.zeros(count, _MESSAGE)
        messages["cdr"] = int.from_bytes(CDR_LITTLE_ENDIAN, "little")
        fill_ticks(messages["payload"], time_us / 1e6, tick, raw, self._rad_per_count)
        packed, size, log = messages.tobytes(), _MESSAGE.itemsize, self._ticks.log
        for number, time_ns in enumerate((self._start_wall_ns + time_us * 1000).tolist()):
            log(packed[number * size : (number + 1) * size], log_time=time_ns)

    def publish_event(self, event: Mapping[str, Any]) -> None:
        """Publish an event."""
        if "gap_s" in event:
            self._clock.skip(float(event["gap_s"]))
        tick = int(event["tick"])
        time_us = self._clock.time_us(tick)
        wall_ns = max(0, self._start_wall_ns + time_us * 1000)
        body = {
            "timestamp": {"sec": wall_ns // 1_000_000_000, "nsec": wall_ns % 1_000_000_000},
            "level": LEVEL_INFO,
            "message": str(event["message"]),
            "name": str(event["name"]),
            "t_s": time_us / 1e6,
            "tick": tick,
        }
        self._events.log(json_bytes(body), log_time=wall_ns)

    def close(self) -> None:
        """Disconnect all viewers."""
        self._gate.close()
        self._server.stop()


def _start_at_secret_address(start_server: Callable[..., Any], **options: Any) -> tuple[Any, str]:
    """Start a server on a random address of this computer; return it and the address. A web page in the
    user's browser cannot guess the address, so that it cannot go round the gate.
    """
    # All addresses 127.x.y.z are of this computer. A system that has 127.0.0.1 only gets that one.
    host = f"127.{secrets.randbelow(254) + 1}.{secrets.randbelow(256)}.{secrets.randbelow(254) + 1}"
    try:
        return start_server(host=host, **options), host
    except (OSError, RuntimeError):
        return start_server(host=HOST, **options), HOST


def read_parts(stream: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield kind and content of each part of a stream, until it ends."""
    while len(head := stream.read(HEADER.size)) == HEADER.size:
        kind, size = HEADER.unpack(head)
        content = stream.read(size)
        if len(content) < size:
            return
        yield kind, content


def _write_answer(content: Mapping[str, Any]) -> None:
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Serve standard input until it ends."""
    # On a busy computer, link and stop have priority. Messages for viewers wait in the feed.
    if hasattr(os, "nice"):
        os.nice(_NICENESS)
    received = read_parts(sys.stdin.buffer)
    first_part = next(received, None)
    if first_part is None:
        return  # the feed has ended before it sent the settings
    _, settings = first_part
    try:
        server = _FoxgloveServer(json.loads(settings))
    except (RuntimeError, ImportError) as error:
        _write_answer({"error": str(error)})
        return
    _write_answer({"port": server.port})
    for kind, content in received:
        if kind == TICKS:
            server.publish_ticks(content)
        else:
            server.publish_event(json.loads(content))
    server.close()
    # Threads of the library must not delay the end.
    os._exit(0)


if __name__ == "__main__":
    main()
