"""The way of a stop through the page's server: a separate socket, or a POST from programs without sockets."""

from __future__ import annotations

import contextlib

from starlette.requests import Request
from starlette.responses import Response
from starlette.websockets import WebSocket, WebSocketDisconnect

from heli_host.errors import HeliError
from heli_host.page.guard import Guard
from heli_host.page.notes import Notes
from heli_host.page.source import Source


class StopEndpoint:
    """Switches the motors off as soon as the message of a stop is read.

    Everything runs in the event loop's thread: a stop waits for no queue, no role and no other client. It
    needs the token of the page, and nothing else.

    Parameters
    ----------
    source : Source
        Board to stop.
    guard : Guard
        Decides which connections are accepted.
    notes : Notes
        The server's log.
    """

    def __init__(self, source: Source, guard: Guard, notes: Notes) -> None:
        self._source = source
        self._guard = guard
        self._notes = notes

    def stop(self) -> str:
        """Switch the motors off, without waiting for any queue or client.

        Returns
        -------
        str
            Error text, empty on success: the client must get an answer even if the stop fails.
        """
        try:
            self._source.stop()
        except HeliError as error:
            return str(error)
        except Exception as error:  # noqa: BLE001
            self._notes.warn(f"a stop failed: {type(error).__name__}: {error}")
            return "the stop failed; use the rig's own stop switch"
        return ""

    async def serve_socket(self, socket: WebSocket) -> None:
        """Stop whenever a message arrives on the socket, whatever it contains, and answer it.

        Parameters
        ----------
        socket : WebSocket
            Not accepted yet.
        """
        if not await self._guard.admit(socket):
            return
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while True:
                message = await socket.receive()
                if message["type"] == "websocket.disconnect":
                    return
                trouble = self.stop()
                await socket.send_text(f"error: {trouble}" if trouble else "stopped")

    async def serve_post(self, request: Request) -> Response:
        """Stop, for a page whose socket is not open, and for ``curl``.

        Parameters
        ----------
        request : Request
            Its body is not read.
        """
        refusal = self._guard.refusal(request)
        if refusal is not None:
            return refusal
        trouble = self.stop()
        return Response(f"{trouble or 'stopped'}\n", 503 if trouble else 200, media_type="text/plain")
