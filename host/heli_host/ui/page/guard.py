"""Access control of the page's server: token, origin and host name of each connection."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from urllib.parse import SplitResult, urlsplit

from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, Response
from starlette.websockets import WebSocket

from heli_host.ui.page.limits import POLICY_VIOLATION
from heli_host.ui.page.notes import Notes

LOCAL_HOSTS = frozenset(("127.0.0.1", "localhost", "::1"))

_LONGEST_PATH = 200


@dataclass(frozen=True)
class Guard:
    """Decides which connections the server accepts."""

    token: str  # Secret that each address must carry. Without it a client sees nothing and commands nothing.
    host: str
    """Address that the server is bound to. If it is local, only requests for a local name are served: this
    refuses a foreign page whose host name resolves to this machine (DNS rebinding)."""
    notes: Notes = field(default_factory=Notes)  # Log for malformed headers

    def refusal(self, connection: HTTPConnection, *, needs_token: bool = True) -> Response | None:
        """Return the error response for a connection that must be refused, otherwise None.

        `needs_token`: True if it must carry the token, which is then checked first.
        """
        if needs_token and not self._has_token(connection):
            message = "open the whole address that heli-host dashboard printed: it carries a token\n"
            return PlainTextResponse(message, 403)
        if (length := len(connection.scope["path"])) > _LONGEST_PATH:
            self._warn(connection, f"its path has {length} characters")
            return PlainTextResponse("the path is too long\n", 414)
        host = connection.headers.get("host", "")
        address = _parse_host(host)
        if address is None:
            self._warn(connection, f"its Host header is {host[:100]!r}")
            return PlainTextResponse("the Host header is not an address\n", 400)
        if self.host in LOCAL_HOSTS and (address.hostname or "") not in LOCAL_HOSTS:
            return PlainTextResponse(f"this page is served as {self.host} only\n", 421)
        origin = connection.headers.get("origin")
        # Programs send no Origin header; browsers send it whenever a page of another origin asks.
        if origin is not None and not self._is_same_origin(connection, origin, host):
            return PlainTextResponse("a page of another origin may not ask this\n", 403)
        return None

    def _has_token(self, connection: HTTPConnection) -> bool:
        """Whether a connection has the token; the duration of the comparison does not reveal the token."""
        received = connection.query_params.get("token", "")
        return secrets.compare_digest(received.encode(), self.token.encode())

    def _is_same_origin(self, connection: HTTPConnection, origin: str, host: str) -> bool:
        """Whether the page at `origin` comes from this server, which the client called `host`."""
        try:
            return urlsplit(origin).netloc.lower() == host.lower()
        except ValueError:
            self._warn(connection, f"its Origin header is {origin[:100]!r}")
            return False

    def _warn(self, connection: HTTPConnection, cause: str) -> None:
        client = connection.client.host if connection.client is not None else "a client"
        self.notes.warn(f"a request of {client} is refused: {cause}")

    async def admit(self, socket: WebSocket) -> bool:
        """Accept a WebSocket, or close it with the code of a policy violation."""
        if self.refusal(socket) is not None:
            await socket.close(POLICY_VIOLATION)
            return False
        await socket.accept()
        return True


def _parse_host(host: str) -> SplitResult | None:
    """Parse a Host header; None if it is not an address, such as ``[``."""
    try:
        return urlsplit(f"//{host}")
    except ValueError:
        return None


def new_token() -> str:
    """Return a random token of 128 bits."""
    return secrets.token_urlsafe(16)
