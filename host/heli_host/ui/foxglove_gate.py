"""Lets viewers on this computer reach the server of live samples, and refuses pages of other origins."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from typing import Final
from urllib.parse import urlsplit

HOST: Final = "127.0.0.1"
LOCAL_NAMES: Final = frozenset(("127.0.0.1", "localhost", "::1"))
VIEWERS: Final = ("https://app.foxglove.dev", "file://")
"""Origins of viewers that are web pages: Foxglove in the browser, and viewers that are installed."""
MAX_VIEWERS: Final = 16
"""Connections at a time. Each costs up to 4 MB of waiting messages."""

_LONGEST_HEAD_BYTES: Final = 16384
_HEAD_S: Final = 5.0
_CHUNK_BYTES: Final = 65536
_REFUSED: Final = b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


def is_permitted(head: bytes) -> bool:
    """Return whether a request may reach the server.

    A browser sends the origin of the page that opens a WebSocket; programs send none. Any page that the user
    visits could otherwise read the samples. The name of the host must be local, because a foreign name may
    lead to this computer (DNS rebinding).
    """
    headers: dict[str, list[str]] = {}
    for line in head.decode("latin-1").split("\r\n")[1:]:
        name, _, value = line.partition(":")
        headers.setdefault(name.strip().lower(), []).append(value.strip())
    hosts, origins = headers.get("host", []), headers.get("origin", [])
    if len(hosts) != 1 or len(origins) > 1 or _name(f"//{hosts[0]}") not in LOCAL_NAMES:
        return False
    return not origins or origins[0] in VIEWERS or _name(origins[0]) in LOCAL_NAMES


class ViewerGate:
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
            if len(self._viewers) > MAX_VIEWERS or not is_permitted(head):
                writer.write(_REFUSED)
                await writer.drain()
                return
            inner_reader, inner_writer = await asyncio.open_connection(*self._inner)
            inner_writer.write(head)
            ways = [
                asyncio.ensure_future(_copy(reader, inner_writer)),
                asyncio.ensure_future(_copy(inner_reader, writer)),
            ]
            _, waiting = await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            for way in waiting:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass
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
