"""Messages to the connected clients: to a single client, or to all of them."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Mapping
from typing import Any

from heli_host.ui.page.notes import Notes
from heli_host.ui.page.outbox import Outbox
from heli_host.ui.page.wire import as_json


class Broadcast:
    """The connected clients, as addressees.

    It owns their outboxes while they are connected. All methods run in the event loop's thread, except
    `tell_all_soon`. None blocks: a slow client loses messages of its own and delays no other.
    """

    def __init__(self, notes: Notes) -> None:
        self.loop: asyncio.AbstractEventLoop | None = None
        self._notes = notes
        self._clients: dict[str, Outbox] = {}

    def add(self, client: Outbox) -> None:
        """Send news to a client from now on."""
        self._clients[client.key] = client

    def remove(self, client: Outbox) -> None:
        """Send a client nothing more."""
        self._clients.pop(client.key, None)

    def tell(self, client: Outbox, news: Mapping[str, Any]) -> None:
        """Send news to a client."""
        client.tell(self.as_json(news))

    def tell_all(self, news: Mapping[str, Any]) -> None:
        """Send news to all clients."""
        try:
            text = self.as_json(news)
        except Exception as error:  # noqa: BLE001 - news that cannot be written must not cost the news after them
            self._notes.warn(f"{', '.join(news)} cannot be sent: {type(error).__name__}: {error}")
            return
        for client in self._clients.values():
            if "status" in news:
                client.tell_status(text)
            else:
                client.tell(text)

    def tell_all_soon(self, news: Mapping[str, Any]) -> None:
        """Send news to all clients, from any thread: the event loop does it next."""
        if self.loop is not None:
            with contextlib.suppress(RuntimeError):
                self.loop.call_soon_threadsafe(self.tell_all, news)

    def as_json(self, news: Mapping[str, Any]) -> str:
        """Return news as JSON, and log numbers that are not finite."""
        text, is_not_finite = as_json(news)
        if is_not_finite:
            self._notes.warn(f"{', '.join(news)} holds a number that is not finite; pages get null")
        return text
