"""Leaves a ``with`` block while the helicopter flies: by its end, or by an exception (argument ``raise``).

Prints as JSON what was seen in flight, how often ``land`` was sent on leaving, and the motors' voltages a
moment later.
"""

import json
import sys
from typing import Any

import heli_host
from heli_host.declaration import MessageId
from heli_host.link.frames import FrameParser


class Mishap(Exception):
    """An error of a user's program."""


def leave(*, by_exception: bool) -> dict[str, Any]:
    """Fly, leave the block, look at the board."""
    sent = bytearray()
    seen: dict[str, Any] = {}
    heli = heli_host.connect("sil://?speed=max")
    transport: Any = heli.session.transport
    world, write = transport.world, transport.write

    def tapped(data: bytes) -> None:
        sent.extend(data)
        write(data)

    try:
        with heli:
            heli.take_off(elevation_deg=0.0)
            seen["state"], seen["elevation_deg"] = str(heli.state), heli.latest.elevation_deg
            seen["volts_in_flight_V"] = world.native.volts_V
            transport.write = tapped
            if by_exception:
                raise Mishap
    except Mishap:
        seen["raised"] = True
    seen["landings"] = sum(frame.id == MessageId.LAND for frame in FrameParser().feed(bytes(sent)))
    world.advance(2)
    seen["volts_V"] = world.native.volts_V
    return seen


if __name__ == "__main__":
    print(json.dumps(leave(by_exception=sys.argv[1:] == ["raise"])))
