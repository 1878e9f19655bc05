"""Flights to measure on: the plans of `make fly`, flown on the simulated board."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from heli_host.fly.heli import Heli
from heli_host.fly.plan import Plan, load_plan
from heli_host.link.session import Session
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import SilOptions
from heli_sim.sil.world import SilWorld

RIG = "makki2024"


class TappedTransport(InProcessTransport):
    """The simulated board, with a copy of every byte that it sends."""

    def __init__(self, world: SilWorld) -> None:
        super().__init__(world)
        self.sent: list[bytes] = []

    def read(self, timeout_s: float) -> bytes:
        data = super().read(timeout_s)
        self.sent.append(data)
        return data


def demonstration() -> list[Plan]:
    """Return the plans of `make fly`."""
    return [load_plan("hover"), load_plan("sine")]


def hover(duration_s: float) -> Plan:
    """Return a plan that hovers for a while."""
    return Plan.parse(
        f'[[segment]]\nkind = "hold"\nduration_s = {duration_s}\n', "hover of the bench", "hover"
    )


@contextmanager
def tapped_board() -> Iterator[tuple[Heli, TappedTransport]]:
    """Connect in lockstep to a simulated board whose bytes are kept."""
    transport = TappedTransport(SilWorld(SilOptions(rig=RIG)))
    session = Session(transport)
    session.connect()
    with Heli(session) as heli:
        yield heli, transport
