"""Who is let in: with the token, from the page itself, under a name of this machine."""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from urllib.parse import urlsplit

from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, Response
from starlette.websockets import WebSocket

LOCAL_HOSTS = frozenset(("127.0.0.1", "localhost", "::1"))

_POLICY_VIOLATION = 1008


@dataclass(frozen=True)
class Guard:
    """The rules.

    Parameters
    ----------
    token : str
        What the address carries; without it nothing is shown or done.
    host : str
        Address that the server is bound to. On a local one, only local names are served: a page elsewhere
        that has its own name point here is refused.
    """

    token: str
    host: str

    def refusal(self, connection: HTTPConnection) -> Response | None:
        """Return why a connection is refused, whatever it carries; None for a good one.

        Parameters
        ----------
        connection : HTTPConnection
            A request, or a socket that wants to be opened.
        """
        asked = connection.headers.get("host", "")
        name = urlsplit(f"//{asked}").hostname or ""
        if self.host in LOCAL_HOSTS and name not in LOCAL_HOSTS:
            return PlainTextResponse(f"this page is served as {self.host} only\n", 421)
        origin = connection.headers.get("origin")
        # A program sends none; a browser always does where it matters.
        if origin is not None and urlsplit(origin).netloc.lower() != asked.lower():
            return PlainTextResponse("a page of another origin may not ask this\n", 403)
        return None

    def refusal_without_token(self, connection: HTTPConnection) -> Response | None:
        """Return why a connection without the token is refused; None for one that has it.

        Parameters
        ----------
        connection : HTTPConnection
            A request, or a socket that wants to be opened.
        """
        given = connection.query_params.get("token", "")
        if secrets.compare_digest(given.encode(), self.token.encode()):
            return None
        words = "open the whole address that heli-host page printed: it carries a token\n"
        return PlainTextResponse(words, 403)

    async def admit(self, socket: WebSocket) -> bool:
        """Open a socket, or refuse to.

        Parameters
        ----------
        socket : WebSocket
            Wants to be opened.

        Returns
        -------
        bool
            Whether it is open.
        """
        if (self.refusal(socket) or self.refusal_without_token(socket)) is not None:
            await socket.close(_POLICY_VIOLATION)
            return False
        await socket.accept()
        return True


def new_token() -> str:
    """Return a token that nobody can guess."""
    return secrets.token_urlsafe(16)
