"""Talks to a 3-DOF helicopter board, real or simulated, over one link.

Ten lines fly it::

    import heli_host

    with heli_host.connect("sil://") as heli:
        heli.take_off(elevation_deg=0.0)
        heli.setpoint(travel_deg=20.0)
        heli.wait(8.0)
        heli.land()
        flown = heli.samples()

Names are loaded when first used, so that a program that only reads logs opens no serial library.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from heli_host.board.heli import Heli
    from heli_host.board.samples import Sample, Samples
    from heli_host.data.flight import Flight
    from heli_host.data.log.reader import read_flight
    from heli_host.declaration import Axes, Excitation, Fault, Flags, State
    from heli_host.errors import HeliError
    from heli_host.fly.connection import connect
    from heli_host.ui.page.client import join

    __version__: str

__all__ = [
    "Axes",
    "Excitation",
    "Fault",
    "Flags",
    "Flight",
    "Heli",
    "HeliError",
    "Sample",
    "Samples",
    "State",
    "connect",
    "join",
    "read_flight",
]

_WHERE = {
    "HeliError": "heli_host.errors",
    "Heli": "heli_host.board.heli",
    "connect": "heli_host.fly.connection",
    "join": "heli_host.ui.page.client",
    "Flight": "heli_host.data.flight",
    "read_flight": "heli_host.data.log.reader",
    "Axes": "heli_host.declaration",
    "Excitation": "heli_host.declaration",
    "Fault": "heli_host.declaration",
    "Flags": "heli_host.declaration",
    "State": "heli_host.declaration",
    "Sample": "heli_host.board.samples",
    "Samples": "heli_host.board.samples",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from heli_host.link.installation import installed_version

        return installed_version()
    if name in _WHERE:
        return getattr(import_module(_WHERE[name]), name)
    raise AttributeError(f"module {__name__} has no attribute {name}")


def __dir__() -> list[str]:
    return sorted({*__all__, "__version__", *(name for name in globals() if name.startswith("__"))})
