"""Requests of clients: how they are validated, who may send each, and in which thread it runs."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final

from heli_host.errors import HeliError, ParameterError, file_remedy
from heli_host.ui.page.clients import Broadcast, ControlLease, Outbox, lease_news
from heli_host.ui.page.gate import stop_motors
from heli_host.ui.page.guard import Notes
from heli_host.ui.page.source import Action, CommandQueue, Role, Source, finite

LONGEST_REQUEST = 4096
"""Largest length of a request in characters. A mark of 200 escaped characters must fit. A much longer message
could keep the event loop busy, and so delay other clients."""
MAX_PENDING: Final = 32
"""Requests of a client that may wait for their answers at a time; more are refused. A page sends a setpoint
every 50 ms, and its answer takes at most about 1 s."""

_LONGEST_ID = 100
_REPORT = "report it with the line in the server's log"


class BadRequest(ParameterError):
    """A message that is not a valid request."""

    def __init__(self, cause: str, remedy: str, message: Mapping[str, Any]) -> None:
        super().__init__(cause, remedy)
        self.message = message


@dataclass(frozen=True)
class PageRequest:
    """A valid request: all its numbers are finite, and UTF-8 can encode all its texts."""

    name: str  # Name of the action, the message's ``do``
    message: Mapping[str, Any]  # The whole message, with ``do`` and ``id``


def read_request(words: str) -> PageRequest:
    """Parse and validate a message."""
    if len(words) > LONGEST_REQUEST:
        cause = f"a request of {len(words)} characters is too long"
        raise BadRequest(cause, f"send at most {LONGEST_REQUEST}", {})
    try:
        message = json.loads(words)
    except (ValueError, RecursionError):
        raise BadRequest("the message is not JSON", "see docs/reference/dashboard-protocol.md", {}) from None
    if not isinstance(message, dict) or not isinstance(message.get("do"), str):
        raise BadRequest("the message is not a request", "see docs/reference/dashboard-protocol.md", {})
    actions: dict[str, Any] = {}
    for name in ("id", "do"):
        value = message.get(name)
        if value is not None and not _is_short(value):
            raise BadRequest(f"{name} of the request is invalid", "send a text or an integer", actions)
        _check_depth_and_text(name, value, actions)
        actions[name] = value
    for name, value in message.items():
        _check_depth_and_text(name, value, actions)
    return PageRequest(message["do"], message)


def _is_short(value: Any) -> bool:
    if isinstance(value, str):
        return len(value) <= _LONGEST_ID
    return isinstance(value, int | float) and not isinstance(value, bool)


def _check_depth_and_text(name: str, value: Any, actions: Mapping[str, Any]) -> None:
    """Raise BadRequest if a value contains, at any depth, text or numbers that logs and JSON cannot store."""
    try:
        name.encode()
        for element in _elements_of_json(value):
            if isinstance(element, str):
                element.encode()
            elif isinstance(element, int | float):
                finite(name, element)
    except UnicodeEncodeError:
        cause = f"{name} holds half of a surrogate pair"
        raise BadRequest(cause, "send text that UTF-8 can hold", actions) from None
    except ParameterError as error:
        raise BadRequest(error.cause, error.remedy, actions) from None


def _elements_of_json(value: Any) -> Iterator[Any]:
    """Yield all keys, texts and numbers in a JSON value, at any depth."""
    # Without recursion, because a message may be a thousand levels deep.
    pending = [value]
    while pending:
        element = pending.pop()
        if isinstance(element, dict):
            pending += [*element.keys(), *element.values()]
        elif isinstance(element, list):
            pending += element
        else:
            yield element


class RequestDispatcher:
    """Checks each request of a client, runs it and answers it."""

    # It owns the queues: one thread for each `CommandQueue`, in which the actions of the source run.
    # Everything else runs in the event loop's thread. A request ``stop`` uses no queue and needs no role.

    def __init__(self, source: Source, lease: ControlLease, broadcast: Broadcast, notes: Notes) -> None:
        self._source = source
        self._lease = lease
        self._broadcast = broadcast
        self._notes = notes
        self._tasks: set[asyncio.Task[None]] = set()
        self._queues = {queue: ThreadPoolExecutor(1, f"page {queue.name.lower()}") for queue in CommandQueue}

    def close(self) -> None:
        """Begin no more actions. Those that run are not waited for."""
        for queue in self._queues.values():
            queue.shutdown(wait=False, cancel_futures=True)

    def take(self, client: Outbox, words: str) -> None:
        """Begin a request; the answer follows when it is done."""
        try:
            request = read_request(words)
        except BadRequest as error:
            self._notes.warn(f"a request of {client.name} is refused: {error}")
            self._broadcast.tell(client, _refusal(error.message, error.cause, error.remedy))
            return
        name, message = request.name, request.message
        if name == "stop":
            trouble = stop_motors(self._source, self._notes)
            answer = {"answer": message.get("id"), "do": name}
            self._broadcast.tell(client, _refusal(message, trouble, "") if trouble else answer)
        elif name in ("ask", "grant", "keep", "share"):
            self._change_lease(client, name, message)
        elif name in self._source.actions:
            if client.pending >= MAX_PENDING:
                cause = f"{MAX_PENDING} of your requests wait for their answers"
                self._broadcast.tell(client, _refusal(message, cause, "wait for an answer, then ask again"))
                return
            client.pending += 1
            # Not awaited: the next words of this client may be more urgent.
            task = asyncio.create_task(self._run_action(client, name, self._source.actions[name], message))
            self._tasks.add(task)
            task.add_done_callback(lambda done: self._finish(client, done))
        else:
            cause = f"unknown request {name[:40]!r}"
            self._broadcast.tell(client, _refusal(message, cause, "see docs/reference/dashboard-protocol.md"))

    def _finish(self, client: Outbox, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        client.pending -= 1

    def _change_lease(self, client: Outbox, name: str, message: Mapping[str, Any]) -> None:
        """Ask for control of the board, grant, refuse or share it; only the pilot decides."""
        now_s = time.monotonic()
        granted = True
        if name == "ask":
            granted = self._lease.ask(client.key, now_s)
        elif client.key != self._lease.pilot:
            self._broadcast.tell(
                client, _refusal(message, "only the pilot can answer this", "ask for control")
            )
            return
        elif name == "share":
            self._lease.shared = bool(message.get("on"))
        else:
            granted = self._lease.answer(client.key, name == "grant")
        self._broadcast.tell(client, {"answer": message.get("id"), "do": name, "granted": granted})
        self._broadcast.tell_all(lease_news(self._lease))

    async def _run_action(
        self, client: Outbox, name: str, action: Action, message: Mapping[str, Any]
    ) -> None:
        """Run an action of the source if the client may request it, and send the result or the error."""
        # While the action waits in its queue, a stop may come, which ends the epoch.
        source, epoch = self._source, self._source.stop_epoch()
        if not self._is_allowed(client, action):
            pilot = self._lease.name(self._lease.pilot) or "no page"
            self._broadcast.tell(
                client, _refusal(message, f"{pilot} is the pilot, and you watch", "ask for control")
            )
            return

        def run() -> Mapping[str, Any]:
            if not source.clear_stop(epoch):
                return {"error": "a stop came before it began", "remedy": "begin again"}
            return action.run(message)

        loop = asyncio.get_running_loop()
        try:
            answer = await loop.run_in_executor(self._queues[action.queue], run)
            text = self._broadcast.as_json({"answer": message.get("id"), "do": name, **answer})
        except HeliError as error:
            self._broadcast.tell(client, _refusal(message, error.cause, error.remedy))
        except OSError as error:
            self._broadcast.tell(client, _refusal(message, error.strerror or str(error), file_remedy(error)))
        except Exception as error:  # noqa: BLE001 - the client must get an answer, and asyncio would print a trace
            self._notes.warn(f"{name} of {client.name} failed: {type(error).__name__}: {error}")
            self._broadcast.tell(client, _refusal(message, f"{name} failed: {type(error).__name__}", _REPORT))
        else:
            client.tell(text)

    def _is_allowed(self, client: Outbox, action: Action) -> bool:
        if action.role is Role.OBSERVER or client.key == self._lease.pilot:
            return True
        return action.role is Role.TUNER and self._lease.shared


def _refusal(message: Mapping[str, Any], cause: str, remedy: str) -> dict[str, Any]:
    return {"answer": message.get("id"), "do": message.get("do"), "error": cause, "remedy": remedy}
