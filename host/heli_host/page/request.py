"""What a client asks for, checked before anything acts on it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from heli_host.errors import ParameterError
from heli_host.page.source import finite

LONGEST_REQUEST = 4096
"""Characters of a request. Shorter, a note of 200 characters would not fit, all of them escaped; longer, one
message could keep the server's only thread busy."""

_LONGEST_ID = 100


class BadRequest(ParameterError):
    """A message that is not a request, or that holds a value which nothing here can use.

    Parameters
    ----------
    cause, remedy : str
        As of every `HeliError`.
    asked : Mapping of str to object
        What the answer may repeat: ``id`` and ``do``, where they are usable.
    """

    def __init__(self, cause: str, remedy: str, asked: Mapping[str, Any]) -> None:
        super().__init__(cause, remedy)
        self.asked = asked


@dataclass(frozen=True)
class Request:
    """A request whose numbers are all finite, and whose texts can all be written to a file.

    Parameters
    ----------
    name : str
        What is asked for.
    asked : Mapping of str to object
        The whole message, with ``do`` and ``id``.
    """

    name: str
    asked: Mapping[str, Any]


def read_request(words: str) -> Request:
    """Read and check a message.

    Parameters
    ----------
    words : str
        As it came.

    Raises
    ------
    BadRequest
        It is not JSON, not a request, or holds a value that is not a finite number or not a text.
    """
    if len(words) > LONGEST_REQUEST:
        cause = f"a request of {len(words)} characters is too long"
        raise BadRequest(cause, f"send at most {LONGEST_REQUEST}", {})
    try:
        asked = json.loads(words)
    except (ValueError, RecursionError):
        raise BadRequest("the message is not JSON", "see docs/page.md for the requests", {}) from None
    if not isinstance(asked, dict) or not isinstance(asked.get("do"), str):
        raise BadRequest("the message is not a request", "see docs/page.md for the requests", {})
    usable: dict[str, Any] = {}
    for name in ("id", "do"):
        value = asked.get(name)
        if value is not None and not _is_short(value):
            raise BadRequest(f"{name} of the request is invalid", "send a text or an integer", usable)
        _check(name, value, usable)
        usable[name] = value
    for name, value in asked.items():
        _check(name, value, usable)
    return Request(asked["do"], asked)


def _is_short(value: Any) -> bool:
    if isinstance(value, str):
        return len(value) <= _LONGEST_ID
    return isinstance(value, int | float) and not isinstance(value, bool)


def _check(name: str, value: Any, usable: Mapping[str, Any]) -> None:
    """Refuse what is in a value, however deep: other programs, logs and JSON have no place for it."""
    try:
        name.encode()
        for part in _parts(value):
            if isinstance(part, str):
                part.encode()
            elif isinstance(part, int | float):
                finite(name, part)
    except UnicodeEncodeError:
        cause = f"{name} holds half of a surrogate pair"
        raise BadRequest(cause, "send text that UTF-8 can hold", usable) from None
    except ParameterError as error:
        raise BadRequest(error.cause, error.remedy, usable) from None


def _parts(value: Any) -> Iterator[Any]:
    """All that is in a value of JSON; without recursion, because a message may be a thousand levels deep."""
    waiting = [value]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict):
            waiting += [*one.keys(), *one.values()]
        elif isinstance(one, list):
            waiting += one
        else:
            yield one
