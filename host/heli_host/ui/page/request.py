"""Requests of clients: parsed and validated before anything acts on them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from heli_host.errors import ParameterError
from heli_host.ui.page.source import finite

LONGEST_REQUEST = 4096
"""Largest length of a request in characters. A mark of 200 escaped characters must fit. A much longer message
could keep the event loop busy, and so delay other clients."""

_LONGEST_ID = 100


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
    """Yield all keys, texts and numbers in a JSON value, at any depth.

    Without recursion, because a message may be a thousand levels deep.
    """
    pending = [value]
    while pending:
        element = pending.pop()
        if isinstance(element, dict):
            pending += [*element.keys(), *element.values()]
        elif isinstance(element, list):
            pending += element
        else:
            yield element
