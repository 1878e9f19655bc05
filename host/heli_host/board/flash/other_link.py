"""Saved parameters of a board whose firmware was built from another declaration of the link.

Framing, hello and welcome are the same in every version. The welcome states the hash of the board's
declaration, and a hello with that hash opens a session. Values carry no names. Therefore they are used only
if the board stored them under this host's schema of the parameters: only telemetry or messages may differ.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

from heli_host.board.parameters import shortest_decimal
from heli_host.declaration import (
    PARAMS,
    PARAMS_HASH,
    HelloMessage,
    ParamsMessage,
    ParamsOriginMessage,
    ParamsOriginReadMessage,
    ParamsReadMessage,
    ParamsSource,
    WelcomeMessage,
)
from heli_host.errors import FlashError, HeliError
from heli_host.link.engine import Command, CommandSlot, RequestNumbers
from heli_host.link.frames import FrameParser, encode_frame

if TYPE_CHECKING:
    from heli_host.link.transport import Transport

_READ_S: Final = 0.02
_NO_HASH: Final = 0
"""In the first hello: the board answers with its own hash, and opens no session."""
_STORED: Final = (ParamsSource.STORED, ParamsSource.FALLBACK, ParamsSource.MIGRATED)


def saved_parameters(transport: Transport, timeout_s: float) -> dict[str, float]:
    """Read the saved parameters of a board that speaks another version of the link."""
    board = _Asker(transport, timeout_s)
    # The first hello asks for the hash of the board's link; a second one with that hash opens the session.
    welcome = WelcomeMessage.unpack(board.ask(HelloMessage(0, _NO_HASH, 0)))
    if welcome.params_source not in _STORED:
        return {}
    board.ask(HelloMessage(0, welcome.link_hash, 0))
    origin = ParamsOriginMessage.unpack(
        board.ask(ParamsOriginReadMessage(0), ParamsOriginMessage.STRUCT.size)
    )
    if origin.schema != PARAMS_HASH or origin.source == ParamsSource.MIGRATED:
        raise _unreadable_error(
            f"it saved them under the schema {origin.schema:08x}, this host's is {PARAMS_HASH:08x}"
        )
    # Under the same schema, the parameters have the names and the order of this host's declaration.
    values: list[float] = []
    while len(values) < len(PARAMS):
        first = len(values)
        payload = board.ask(ParamsReadMessage(0, first))
        head, size = ParamsMessage.unpack(payload), ParamsMessage.STRUCT.size
        if head.first != first or head.count == 0 or len(payload) != size + 4 * head.count:
            raise _unreadable_error("its list of parameters has another layout")
        values += struct.unpack_from(f"<{head.count}f", payload, size)
    return {spec.name: shortest_decimal(value) for spec, value in zip(PARAMS, values, strict=True)}


class _Asker:
    """Sends requests to a board without a session, and waits for their answers; ignores other messages."""

    def __init__(self, transport: Transport, timeout_s: float) -> None:
        self._transport = transport
        self._timeout_s = timeout_s
        self._parser = FrameParser()
        self._slot = CommandSlot(RequestNumbers(0))

    def ask(self, command: Command, size: int = 0) -> bytes:
        """Send a request until it is answered; return the answer's payload, of at least `size` bytes."""
        request = self._slot.ask(command, self._transport.now_s(), self._timeout_s)
        while not request.done:
            now_s = self._transport.now_s()
            if (due := self._slot.due(now_s)) is not None:
                self._transport.write(encode_frame(due.ID, due.request, due.pack()))
            for frame in self._parser.feed(self._transport.read(_READ_S)):
                self._slot.match(frame)
            self._slot.expire(now_s)
        try:
            payload = request.answer().payload
        except HeliError as error:
            raise _unreadable_error("it does not answer the request for them") from error
        if len(payload) < size:
            raise _unreadable_error("it answers the request for them in another layout")
        return payload


def _unreadable_error(reason: str) -> FlashError:
    """Return the error for saved parameters that this host cannot read."""
    return FlashError(
        f"the board has saved parameters that this host cannot read: {reason}",
        "save them with the board's own heli_host (params dump), or add --discard-parameters",
    )
