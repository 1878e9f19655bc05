"""Checks the requests of clients, runs each in its thread, and sends the answers."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

from heli_host.errors import HeliError, file_remedy
from heli_host.ui.page.broadcast import Broadcast
from heli_host.ui.page.control_lease import ControlLease
from heli_host.ui.page.notes import Notes
from heli_host.ui.page.outbox import Outbox
from heli_host.ui.page.request import BadRequest, read_request
from heli_host.ui.page.source import Action, CommandQueue, Role, Source
from heli_host.ui.page.stop_endpoint import stop_motors

MAX_PENDING: Final = 32
"""Requests of a client that may wait for their answers at a time; more are refused. A page sends a setpoint
every 50 ms, and its answer takes at most about 1 s."""

_REPORT = "report it with the line in the server's log"


class RequestDispatcher:
    """Checks each request of a client, runs it and answers it.

    It owns the queues: one thread for each `CommandQueue`, in which the actions of the source run. Everything
    else runs in the event loop's thread. A request ``stop`` uses no queue and needs no role.
    """

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


def lease_news(lease: ControlLease) -> dict[str, Any]:
    """Return who is the pilot and who asks for control, as news for all clients."""
    return {
        "control": {
            "pilot": lease.pilot,
            "pilot_name": lease.name(lease.pilot),
            "present": lease.present(time.monotonic()),
            "asking": lease.asking,
            "asking_name": lease.name(lease.asking),
            "shared": lease.shared,
            "clients": lease.count(),
        }
    }


def _refusal(message: Mapping[str, Any], cause: str, remedy: str) -> dict[str, Any]:
    return {"answer": message.get("id"), "do": message.get("do"), "error": cause, "remedy": remedy}
